from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from carff.states import (
    ActorBox,
    ambiguous_groups,
    branch_ambiguous,
    build_state_table,
    connected_groups,
    determined,
    group_sizes,
    state_ceiling,
    state_chances,
)
from hashnerf.cameras import Cameras
from hashnerf.errors import DataError, UserError
from hashnerf.posed_images import Frame, PosedImages
from tests.hashnerf.refusals import refuses

BOX = {"center": [1, 2.5, 0.75], "size": [4.5, 1.8, 1.5], "yaw": 0.5}


def data_set(views: list[tuple[int, int, int]], splits: dict[int, str] | None = None, **extras) -> PosedImages:
    """A data set of 2 x 2 pictures with these (branch, step, camera); camera c stands at x = c."""
    frames = tuple(
        Frame(f"images/b{branch}_s{step}_c{camera}.png", (splits or {}).get(camera, "train"), branch, step, camera)
        for branch, step, camera in views
    )
    n = len(frames)
    pose = torch.eye(4).repeat(n, 1, 1)
    pose[:, 0, 3] = torch.tensor([float(frame.camera) for frame in frames])
    cameras = Cameras(pose, torch.ones(n, 2), torch.ones(n, 2), torch.zeros(n, 4), 2, 2)
    images = torch.zeros(n, 2, 2, 3, dtype=torch.uint8)
    return PosedImages(images, cameras, frames, torch.tensor([[0.0, 0, 0], [1, 1, 1]]), extras, Path("data/x"))


def grid(branches: int, steps: int, cameras: int) -> list[tuple[int, int, int]]:
    return [(b, s, c) for b in range(branches) for s in range(steps) for c in range(cameras)]


# --- the table ---


def test_states_views_and_successors_by_hand():
    views = [(1, 0, 1), (0, 1, 0), (0, 0, 0), (1, 1, 0), (0, 0, 1), (1, 0, 0)]
    table = build_state_table(data_set(views))
    assert table.states == ((0, 0), (0, 1), (1, 0), (1, 1))
    assert table.views.tolist() == [[2, 4], [1, -1], [5, 0], [3, -1]]
    assert table.successor.tolist() == [1, -1, 3, -1]
    assert table.transitions().tolist() == [[0, 1], [2, 3]]
    assert table.branch.tolist() == [0, 0, 1, 1]
    assert table.index(1, 0) == 2
    assert table.camera_poses[:, 0, 3].tolist() == [0.0, 1.0]
    assert table.camera_kinds == ("unknown", "unknown") and table.branch_names == ("branch 0", "branch 1")


def test_branches_of_any_number_and_length():
    views = [(0, 0, 0), (0, 1, 0), (0, 2, 0), (1, 0, 0), (4, 0, 0), (4, 1, 0)]
    assert build_state_table(data_set(views)).successor.tolist() == [1, 2, -1, -1, 5, -1]


def test_every_second_step_is_evenly_spaced_too():
    assert build_state_table(data_set([(0, s, 0) for s in (0, 2, 4)])).successor.tolist() == [1, 2, -1]


@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 3), st.randoms())
@settings(max_examples=20, deadline=None)
def test_every_view_is_found_whatever_its_place_in_the_file(branches, steps, cameras, random):
    views = grid(branches, steps, cameras)
    random.shuffle(views)
    table = build_state_table(data_set(views))
    for row, (branch, step, camera) in enumerate(views):
        assert table.views[table.index(branch, step), camera] == row
    assert int((table.successor >= 0).sum()) == branches * (steps - 1)


def test_one_split_of_the_views():
    table = build_state_table(data_set(grid(1, 2, 3), splits={1: "test", 2: "val"}))
    assert table.view_index("train").tolist() == [[0, -1, -1], [3, -1, -1]]
    assert table.view_index("test").tolist() == [[-1, 1, -1], [-1, 4, -1]]
    assert table.view_index().tolist() == [[0, 1, 2], [3, 4, 5]]


def test_names_hazards_and_boxes():
    posed = data_set(
        grid(2, 1, 1),
        branches=["absent", "present"],
        camera_kinds=["ego"],
        states=[{"branch": 1, "step": 0, "hazard": True}, {"branch": 0, "step": 0, "hazard": False}],
        actors={"truck": [{"branch": 1, "step": 0, **BOX}], "ego": [{"branch": 0, "step": 0, **BOX}]},
    )
    table = build_state_table(posed)
    assert table.branch_names == ("absent", "present") and table.camera_kinds == ("ego",)
    assert table.known_hazard().tolist() == [False, True]
    assert table.actor_names == ("ego", "truck")
    box = ActorBox("truck", (1.0, 2.5, 0.75), (4.5, 1.8, 1.5), 0.5)
    assert table.actors == ((replace(box, name="ego"),), (box,))


def test_branches_happen_alike_unless_weighed():
    assert build_state_table(data_set(grid(2, 1, 1))).branch_weight.tolist() == [0.5, 0.5]
    named = build_state_table(data_set(grid(2, 1, 1), branches=["absent", "present", "never seen"]))
    assert named.branch_weight.tolist() == [0.5, 0.5, 0.0]
    weighed = build_state_table(data_set(grid(3, 1, 1), branch_weights=[2, 1, 1]))
    assert weighed.branch_weight.tolist() == [0.5, 0.25, 0.25]
    gap = build_state_table(data_set([(0, 0, 0), (2, 0, 0)]))
    assert gap.branch_weight.tolist() == [0.5, 0.0, 0.5]


def test_hazards_that_are_not_all_stated_are_unknown():
    for states in (None, [{"branch": 0, "step": 0}], [{"branch": 0, "step": 0, "hazard": None}]):
        table = build_state_table(data_set(grid(1, 1, 1), states=states))
        assert table.hazard is None
        with pytest.raises(UserError, match="hazard"):
            table.known_hazard()


def test_visibility_of_actors():
    posed = data_set(
        grid(2, 1, 3),
        actors={"truck": [{"branch": 1, "step": 0, **BOX}]},
        visibility={"truck": [[1, 0, 0, 30, 120], [1, 0, 1, 0, 0]]},
    )
    table = build_state_table(posed)
    # Absent in branch 0: nothing to see. Present in branch 1: 30 / 120, out of the picture, not stated.
    assert table.visible_fraction("truck").tolist() == [[0, 0, 0], [0.25, 0, -1]]
    assert table.visible_px[1, :, 0].tolist() == [30, 0, -1]
    assert table.unoccluded_px[1, :, 0].tolist() == [120, 0, -1]
    with pytest.raises(UserError, match="no actor named 'car'; the data set has truck"):
        table.visible_fraction("car")


# --- problems ---


def test_k44_all_problems_are_reported_at_once(numeric_row):
    posed = data_set([(0, 0, 0), (0, 0, 0), (0, 1, 2), (0, 4, 0)], states=[{"branch": 7, "step": 0, "hazard": True}])
    posed.cameras.pose[3, 1, 3] = 5.0
    with pytest.raises(DataError) as caught:
        build_state_table(posed)
    text = str(caught.value)
    assert len(caught.value.problems) == 5
    sentences = (
        "data/x: 5 problems",
        "are both branch 0 step 0 camera 0",
        "cameras 1 have no view",
        "cameras 0 have different poses",
        "1 after branch 0 step 0, 3 after branch 0 step 1",
        "states (7, 0) (branch, step) have no view",
    )
    untold = [sentence for sentence in sentences if sentence not in text]
    numeric_row("K44", "a state twice, a gap, a state without views: not told with the folder", len(untold))


def test_k44_a_single_step_cannot_be_forecast(numeric_row):
    table = build_state_table(data_set(grid(2, 1, 1)))
    numeric_row("K44", "one step a branch: forecast all the same", not refuses("two steps or more", table.transitions))


def test_k44_the_order_of_the_file_is_not_that_of_time(numeric_row):
    views = [(0, step, 0) for step in (4, 0, 6, 2)]
    wrong = build_state_table(data_set(views)).successor.tolist() != [1, 2, 3, -1]
    numeric_row("K44", "steps in any order: a successor that is not the next step", wrong)


def test_an_empty_data_set_and_an_unknown_state_are_refused():
    with pytest.raises(UserError, match="no views"):
        build_state_table(data_set([]))
    with pytest.raises(UserError, match="no state at branch 3, step 9"):
        build_state_table(data_set(grid(1, 1, 1))).index(3, 9)


# --- equal pictures ---


def pictures(values: list[list[int | None]]) -> tuple[torch.Tensor, torch.Tensor]:
    """One grey 1 x 1 picture per (state, camera); None = no view."""
    views = torch.full((len(values), len(values[0])), -1)
    images = []
    for state, row in enumerate(values):
        for camera, value in enumerate(row):
            if value is not None:
                views[state, camera] = len(images)
                images.append(torch.full((1, 1, 3), value, dtype=torch.uint8))
    return torch.stack(images), views


def test_groups_by_hand():
    # Camera 0: states 0, 2, 3 look alike. Camera 1: all differ. Camera 2: 1 and 3 alike, 0 missing.
    images, views = pictures([[7, 1, None], [9, 2, 5], [7, 3, 6], [7, 4, 5]])
    groups = ambiguous_groups(images, views)
    assert groups.tolist() == [[0, 0, -1], [1, 1, 1], [0, 2, 2], [0, 3, 1]]
    assert group_sizes(groups).tolist() == [[3, 1, 0], [1, 1, 2], [3, 1, 1], [3, 1, 2]]
    # (3 * 1/3 + 1 + 4 + 2 * 1/2 + 1) / 11 = 8 / 11: as many right answers as there are different pictures.
    assert state_ceiling(groups) == pytest.approx(8 / 11)
    assert determined(groups).tolist() == [[0, 1, 0], [1, 1, 0], [0, 1, 1], [0, 1, 0]]
    # States 0, 1 are branch 0 and states 2, 3 branch 1.
    ambiguous = branch_ambiguous(groups, torch.tensor([0, 0, 1, 1]))
    assert ambiguous.tolist() == [[1, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 1]]


def test_equal_pictures_of_one_branch_are_not_ambiguous_between_branches():
    groups = ambiguous_groups(*pictures([[7], [7], [8], [9]]))
    assert branch_ambiguous(groups, torch.tensor([0, 0, 1, 1])).tolist() == [[0], [0], [0], [0]]


def test_tolerance_counts_levels_in_both_directions_and_through_a_chain():
    # 0 - 2 - 4 are linked by steps of 2; 255 must not wrap round to 0.
    images, views = pictures([[4], [0], [255], [2], [9]])
    assert ambiguous_groups(images, views, tolerance=1).tolist() == [[0], [1], [2], [3], [4]]
    assert ambiguous_groups(images, views, tolerance=2).tolist() == [[0], [0], [2], [0], [4]]


def test_one_pixel_makes_a_difference():
    images = torch.zeros(2, 4, 4, 3, dtype=torch.uint8)
    views = torch.tensor([[0], [1]])
    assert ambiguous_groups(images, views).tolist() == [[0], [0]]
    images[1, 3, 3, 2] = 1
    assert ambiguous_groups(images, views).tolist() == [[0], [1]]


@given(st.lists(st.lists(st.integers(0, 3), min_size=2, max_size=2), min_size=1, max_size=6))
@settings(max_examples=30, deadline=None)
def test_the_ceiling_is_what_the_best_classifier_reaches(values):
    images, views = pictures(values)
    seen: dict[tuple[int, int], int] = {}
    right = 0
    for state, row in enumerate(values):
        for camera, value in enumerate(row):
            right += seen.setdefault((camera, value), state) == state
    assert state_ceiling(ambiguous_groups(images, views)) == pytest.approx(right / views.numel())


def test_groups_of_a_chain_and_of_nothing():
    same = torch.zeros(6, 6, dtype=torch.bool)
    for a, b in ((5, 4), (4, 2), (2, 0), (1, 3)):
        same[a, b] = True
    assert connected_groups(same).tolist() == [0, 1, 0, 1, 0, 0]
    assert connected_groups(torch.zeros(3, 3, dtype=torch.bool)).tolist() == [0, 1, 2]


def test_no_views_have_no_ceiling():
    with pytest.raises(UserError, match="at least one view"):
        state_ceiling(torch.full((2, 2), -1))


def test_equal_pictures_share_their_states_by_weight():
    groups = torch.tensor([[0, 0], [0, 1], [2, -1]])
    chances = state_chances(groups, torch.tensor([0.5, 0.25, 0.25]))
    third = 1 / 3
    assert torch.allclose(chances[:, 0], torch.tensor([[2 * third, third, 0], [2 * third, third, 0], [0, 0, 1.0]]))
    assert torch.allclose(chances[:, 1], torch.tensor([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 0]]))


def test_a_camera_without_any_view_has_no_groups():
    images = torch.zeros(2, 2, 2, 3, dtype=torch.uint8)
    assert ambiguous_groups(images, torch.tensor([[0, -1], [1, -1]])).tolist() == [[0, -1], [0, -1]]
