"""What is known about every view, on the tiny data set: camera 0 never shows the truck, the others show all of it."""

from dataclasses import replace

import pytest
import torch

from carff import evaluation_data
from carff.evaluation_data import (
    FULL,
    NONE,
    UNSTATED,
    actor_visible,
    first_equal,
    load_evaluation_data,
    main_actor,
    one_label,
    visibility_class,
)
from carff.states import build_state_table
from hashnerf.errors import UserError

# State numbers: 0 absent t0, 1 absent t1, 2 present t0, 3 present t1.


def test_only_the_hiding_camera_leaves_states_open(tiny_evaluation):
    views = tiny_evaluation.views
    assert len(views) == 16
    assert torch.equal(views.determined, views.camera != 0)
    # camera 0: absent t0 looks like present t0, absent t1 like present t1; the other 12 pictures are their own
    assert len(views.picture.unique()) == 14
    at = {(int(s), int(c)): int(p) for s, c, p in zip(views.state, views.camera, views.picture)}
    assert at[0, 0] == at[2, 0] != at[1, 0] == at[3, 0]


def test_splits_kinds_and_successors(tiny_evaluation):
    views = tiny_evaluation.views
    assert torch.equal(views.test, views.camera == 2) and torch.equal(views.train, views.camera != 2)
    assert torch.equal(views.ego, views.camera != 3)
    assert torch.equal(tiny_evaluation.goes_on(), (views.state == 0) | (views.state == 2))


def test_every_camera_is_the_egos_where_kinds_are_not_named(tiny_data, tiny_evaluation):
    extras = {key: value for key, value in tiny_data.extras.items() if key != "camera_kinds"}
    table = build_state_table(replace(tiny_data, extras=extras))
    views = evaluation_data.all_views(table, tiny_evaluation.groups, tiny_evaluation.model.encode(tiny_data.images))
    assert views.ego.all()


def test_selecting_views_keeps_rows_together(tiny_evaluation):
    some = tiny_evaluation.views.select(torch.tensor([5, 2]))
    assert some.frame.tolist() == [5, 2] and torch.equal(some.belief.mean, tiny_evaluation.views.belief.mean[[5, 2]])


def test_an_empty_junction_counts_as_seen_where_the_truck_would_be(tiny_table):
    level = visibility_class(tiny_table)
    assert (level[:, 0] == NONE).all()
    assert (level[:, 1:] == FULL).all(), "absent states have the class of the present state at the same step"
    visible = actor_visible(tiny_table)
    assert not visible[:2].any() and not visible[:, 0].any() and visible[2:, 1:].all()


def test_visibility_that_nobody_states_is_unstated_in_every_branch(tiny_data):
    rows = [row for row in tiny_data.extras["visibility"]["truck"] if row[1:3] != [0, 1]]
    table = build_state_table(replace(tiny_data, extras={**tiny_data.extras, "visibility": {"truck": rows}}))
    level = visibility_class(table)
    assert level[0, 1] == level[2, 1] == UNSTATED
    assert level[1, 1] == level[3, 1] == FULL


def test_the_main_actor_is_the_one_that_tells_branches_apart(tiny_data, tiny_table):
    assert main_actor(tiny_table) == "truck"
    # The lead car moves, but alike in both branches; this truck is there at the last step of one branch only. Pairs of
    # different steps would count two for either car.
    lead = [
        {"branch": b, "step": s, "center": [3.0 * s, 0.0, 0.5], "size": [1.0, 1.0, 1.0], "yaw": 0.0}
        for b in range(2)
        for s in range(2)
    ]
    actors = {**tiny_data.extras["actors"], "lead": lead, "truck": tiny_data.extras["actors"]["truck"][1:]}
    extras = {**tiny_data.extras, "actors": actors, "visibility": {}}
    assert main_actor(build_state_table(replace(tiny_data, extras=extras))) == "truck"
    only_ego = {"ego": tiny_data.extras["actors"]["ego"]}
    extras = {**tiny_data.extras, "actors": only_ego, "visibility": {}}
    alone = build_state_table(replace(tiny_data, extras=extras))
    assert main_actor(alone) is None and (visibility_class(alone) == UNSTATED).all()


def test_states_with_equal_boxes_share_their_vote(tiny_evaluation):
    occupied = tiny_evaluation.model.probe.candidates.occupied
    assert tiny_evaluation.same_boxes.tolist() == [0, 1, 2, 3]
    assert torch.equal(tiny_evaluation.branch_share(), torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]))
    occupied[2] = occupied[0]  # as if no actor told the branches apart at step 0
    assert tiny_evaluation.same_boxes.tolist() == [0, 1, 0, 3]
    assert tiny_evaluation.branch_share()[[0, 2]].tolist() == [[0.5, 0.5], [0.5, 0.5]]


def test_first_equal_row():
    rows = torch.tensor([[True, False], [False, False], [True, False], [False, False], [True, True]])
    assert first_equal(rows).tolist() == [0, 1, 0, 1, 4]


def test_pictures_with_one_label():
    picture, label = torch.tensor([4, 4, 7, 7, 0]), torch.tensor([2, 3, 5, 5, 9])
    assert one_label(picture, label).tolist() == [False, False, True, True, True]
    none = torch.zeros(0, dtype=torch.int64)
    assert one_label(none, none).shape == (0,)


def test_a_missing_picture_is_grey(tiny_evaluation):
    views = tiny_evaluation.table.views.clone()
    views[1, 2] = -1
    holed = replace(tiny_evaluation, table=replace(tiny_evaluation.table, views=views))
    pictures = holed.pictures_at(2)
    assert (pictures[1] == evaluation_data.MISSING_GREY).all()
    assert (pictures[0] == tiny_evaluation.data.images[views[0, 2]].numpy()).all()


def test_generators_depend_on_seed_and_asker_alone(tiny_evaluation):
    draws = [torch.rand(1, generator=tiny_evaluation.generator(salt)).item() for salt in (1, 1, 2)]
    assert draws[0] == draws[1] != draws[2]


def test_other_data_than_the_run_learned_is_refused(tiny_evaluation, monkeypatch):
    model, data = tiny_evaluation.model, tiny_evaluation.data
    monkeypatch.setattr(evaluation_data, "load_carff", lambda folder: model)
    monkeypatch.setattr(evaluation_data, "load_posed_images", lambda folder, size: data)
    loaded = load_evaluation_data(tiny_evaluation.config)
    assert torch.equal(loaded.groups, tiny_evaluation.groups)

    other = replace(data, extras={**data.extras, "camera_kinds": ["ego"] * 4})
    monkeypatch.setattr(evaluation_data, "load_posed_images", lambda folder, size: other)
    with pytest.raises(UserError, match="other states or cameras"):
        load_evaluation_data(tiny_evaluation.config)

    small = replace(data, images=data.images[:, ::2, ::2], cameras=data.cameras.scaled(16, 16))
    monkeypatch.setattr(evaluation_data, "load_posed_images", lambda folder, size: small)
    with pytest.raises(UserError, match=r"image_size.*32 x 32 pixels, not 16 x 16"):
        load_evaluation_data(tiny_evaluation.config)


def test_capacity_that_was_derived_when_training_is_no_other_setting(tiny_evaluation, monkeypatch):
    monkeypatch.setattr(evaluation_data, "load_carff", lambda folder: tiny_evaluation.model)
    monkeypatch.setattr(evaluation_data, "load_posed_images", lambda folder, size: tiny_evaluation.data)
    nerf = tiny_evaluation.config.nerf
    opened = replace(nerf, field=replace(nerf.field, levels=0, log2_table_size=0))
    assert load_evaluation_data(replace(tiny_evaluation.config, nerf=opened)).config.nerf == nerf
    stated = replace(nerf, field=replace(nerf.field, levels=0, log2_table_size=5))
    with pytest.raises(UserError, match="log2_table_size"):
        load_evaluation_data(replace(tiny_evaluation.config, nerf=stated))
