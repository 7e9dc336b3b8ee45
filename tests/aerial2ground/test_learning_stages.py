"""Collected drives and the networks that learn from them and from ground views."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from aerial2ground.config import from_drives
from aerial2ground.ground_views import load_views
from aerial2ground.learning_stages import (
    is_trained,
    load_network,
    localiser_folder,
    methods_of,
    pictures_of,
    policy_folder,
    run_drives,
    run_localisers,
    run_policies,
)
from aerial2ground.networks import NetworkConfig
from aerial2ground.stages import load_survey, run_ground_views, run_reconstruction
from hashnerf.checkpoints import TENSORS
from hashnerf.errors import UserError


@pytest.fixture
def driven_run(tiny_run):
    """A run with ground views, collected drives and views of the field made of those."""
    run_ground_views(tiny_run)
    run_drives(tiny_run)
    collected = from_drives(tiny_run)
    run_reconstruction(collected)
    run_ground_views(collected)
    return tiny_run


def test_collected_pictures_are_a_data_set_of_poses_near_the_path(driven_run):
    collected = load_survey(from_drives(driven_run))
    assert len(collected.test) == 0 and set(collected.trajectories) == {"outer_loop", "left_turns", "right_turns"}
    total = 0
    for name, path in collected.trajectories.items():
        views = load_views(driven_run.drives / name)
        aside = [path.nearest(pose[:2])[1] for pose in views.poses]
        assert 0 < np.abs(aside).max() < 0.175 and abs(views.arc[-1] - views.arc[0]) > 0
        total += len(views.poses)
    assert len(collected.data) == total


def test_methods_learn_from_what_they_may_see(driven_run):
    sizes = {method: [len(part.poses) for part in pictures_of(driven_run, method, "outer_loop")] for method in
             ("imit", "imit_gv", "ours", "ours_gv", "baseline")}  # fmt: skip
    drives, drone, augmented = sizes["imit"][0], 6, 4
    assert sizes["baseline"] == sizes["imit"] == [drives] and sizes["imit_gv"] == [drives, augmented]
    assert sizes["ours"] == [drone] and sizes["ours_gv"] == [drone, drives, augmented]


def test_a_network_for_every_trajectory_method_and_seed(driven_run):
    config = replace(driven_run, seeds=2)
    calls = []
    run_policies(config, lambda done, total: calls.append((done, total)))
    assert calls[0] == (0, 24) and calls[-1] == (24, 24)
    folders = [policy_folder(config, "left_turns", "ours_gv", seed) for seed in (0, 1)]
    one, other = (load_network(folder, NetworkConfig()) for folder in folders)
    assert (one.height, one.width) == (18, 32)
    assert not np.array_equal(one.head[1].weight.detach().numpy(), other.head[1].weight.detach().numpy())
    calls.clear()
    run_policies(config, lambda done, total: calls.append((done, total)))
    assert calls == [(24, 24)], "trained networks are kept"
    run_localisers(driven_run)
    assert all(is_trained(localiser_folder(driven_run, method, 0)) for method in ("ours", "baseline"))


def test_networks_made_from_something_else_are_refused_and_nothing_is_lost(tiny_run):
    run_ground_views(tiny_run)
    run_localisers(tiny_run)
    folder = localiser_folder(tiny_run, "ours", 0)
    before = weights(folder)
    task = replace(tiny_run.localisation.task, weight_decay=0.5)
    other = replace(tiny_run, localisation=replace(tiny_run.localisation, task=task))
    with pytest.raises(UserError, match=r"weight_decay: 0.0 -> 0.5.*--overwrite true"):
        run_localisers(other)
    assert weights(folder) == before
    run_localisers(replace(other, overwrite=True))
    assert weights(folder) != before


def test_what_cannot_be_trained_anew_is_kept(tiny_run):
    run_ground_views(tiny_run)
    run_localisers(tiny_run)
    before = weights(localiser_folder(tiny_run, "ours", 0))
    shutil.rmtree(tiny_run.folder / "ground")
    with pytest.raises(UserError, match="no ground views here"):
        run_localisers(replace(tiny_run, overwrite=True))
    assert weights(localiser_folder(tiny_run, "ours", 0)) == before


def test_a_damaged_network_is_trained_again(tiny_run):
    run_ground_views(tiny_run)
    run_localisers(tiny_run)
    folder = localiser_folder(tiny_run, "ours", 0)
    before = weights(folder)
    (folder / "0000000" / TENSORS).write_bytes(before[:100])
    run_localisers(tiny_run)
    assert weights(folder) == before


def weights(folder):
    return (folder / "0000000" / TENSORS).read_bytes()


def test_collected_pictures_of_another_camera_are_refused(driven_run):
    other = replace(driven_run, camera=replace(driven_run.camera, width=40))
    with pytest.raises(UserError, match=r"camera.width: 32 -> 40"):
        run_drives(other)
    assert load_views(driven_run.drives / "outer_loop").pictures.shape[2] == 32


def test_half_collected_drives_do_not_count(tiny_run):
    (tiny_run.drives / "outer_loop").mkdir(parents=True)
    assert methods_of(tiny_run, ("imit", "ours")) == ["ours"]


def test_without_collected_pictures_there_is_only_ours(tiny_run):
    assert methods_of(tiny_run, ("imit", "ours")) == ["ours"]


def test_stages_in_the_wrong_order_name_the_script(tiny_run):
    with pytest.raises(UserError, match=r"run scripts/make_ground_views"):
        run_policies(tiny_run)
    with pytest.raises(UserError, match=r"run scripts/train_policy"):
        load_network(tiny_run.folder / "policies" / "x", NetworkConfig())
