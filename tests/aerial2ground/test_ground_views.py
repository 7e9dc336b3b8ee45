"""Ground views on disk: whole or not there, continued after an interruption, readable as any data set."""

import json

import numpy as np
import pytest
import torch

from aerial2ground.car_camera import CarCameraConfig
from aerial2ground.ground_poses import DisturbanceConfig, disturbed_poses
from aerial2ground.ground_views import cameras_of, describe_views, is_there, load_views, render_views
from aerial2ground.paths import Path
from hashnerf.errors import UserError
from hashnerf.image_files import write_png
from hashnerf.posed_images import load_depth, load_posed_images

LINE = Path(np.array([(0.0, 0.0), (4.0, 0.0)]))
CAR = disturbed_poses(LINE, 9, DisturbanceConfig(), np.random.default_rng(0))
CAMERAS = cameras_of(CarCameraConfig(width=16, height=9), CAR, 0.0)
BOX = torch.tensor([[-1.0, -1.0, -0.1], [5.0, 1.0, 1.0]])


def flat(cameras, indices):
    """Every picture has one colour and one depth of its own."""
    for index in indices:
        yield np.full((9, 16, 3), 10 * index, np.uint8), np.full((9, 16), 1.0 + index / 8)


def make_flat():
    return flat


def write(folder, workers=1):
    render_views(make_flat, [(CAMERAS, folder)], workers)
    describe_views(CAMERAS, CAR, np.linspace(-0.4, 0.4, 9), folder, BOX, {})


@pytest.mark.parametrize("workers", [1, 2])
def test_what_was_rendered_is_read(tmp_path, workers):
    write(tmp_path, workers)
    views = load_views(tmp_path)
    assert views.pictures[:, 0, 0, 0].tolist() == [10 * i for i in range(9)]
    assert views.depth[:, 0, 0].tolist() == pytest.approx([1.0 + i / 8 for i in range(9)])
    assert np.allclose(views.poses, CAR.poses) and np.allclose(views.arc, CAR.arc)
    assert views.steering == pytest.approx(np.linspace(-0.4, 0.4, 9))


def test_depth_becomes_a_fourth_channel(tmp_path):
    write(tmp_path)
    views = load_views(tmp_path)
    both = views.rgbd(4.0)
    assert both.dtype == torch.uint8 and torch.equal(both[..., :3], views.pictures)
    # 255 * (1 + i / 8) / 4
    assert both[:, 0, 0, 3].tolist() == [64, 72, 80, 88, 96, 104, 112, 120, 128]


def test_other_tools_can_read_it(tmp_path):
    write(tmp_path)
    posed = load_posed_images(tmp_path)
    assert len(posed) == 9 and (posed.cameras.width, posed.cameras.height) == (16, 9)
    assert torch.allclose(posed.cameras.focal, CAMERAS.focal, atol=1e-3)
    moved = posed.cameras.pose[:, :3, 3].double() + posed.origin
    assert torch.allclose(moved, CAMERAS.pose[:, :3, 3].double(), atol=1e-5)
    assert load_depth(posed)[3, 0, 0] == pytest.approx(1.375)


def test_an_interrupted_call_goes_on(tmp_path):
    calls = []

    def breaking():
        def render(cameras, indices):
            for index in indices:
                calls.append(index)
                if len(calls) == 5:
                    raise KeyboardInterrupt
                yield from flat(cameras, [index])

        return render

    with pytest.raises(KeyboardInterrupt):
        render_views(breaking, [(CAMERAS, tmp_path)], 1)
    assert [is_there(tmp_path, index) for index in range(9)] == [True] * 4 + [False] * 5
    seen = []
    render_views(breaking, [(CAMERAS, tmp_path)], 1, lambda done, total: seen.append((done, total)))
    assert calls[5:] == [4, 5, 6, 7, 8], "only what was missing"
    assert seen[0] == (4, 9) and seen[-1] == (9, 9)


def test_all_sets_are_rendered_by_one_renderer(tmp_path):
    made = []

    def make():
        made.append(1)
        return flat

    sets = [(CAMERAS, tmp_path / "a"), (CAMERAS.select([0, 1]), tmp_path / "b")]
    seen = []
    render_views(make, sets, 1, lambda done, total: seen.append((done, total)))
    assert made == [1] and seen[-1] == (11, 11)
    assert is_there(tmp_path / "a", 8) and is_there(tmp_path / "b", 1) and not is_there(tmp_path / "b", 2)


def test_folders_that_are_no_ground_views(tmp_path):
    with pytest.raises(UserError, match="no ground views here; run scripts/make_ground_views"):
        load_views(tmp_path)
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [{"file_path": "x.png"}]}))
    with pytest.raises(UserError, match="frames lack car_pose"):
        load_views(tmp_path)
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": []}))
    with pytest.raises(UserError, match="holds no frames"):
        load_views(tmp_path)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"arc": None}, "a frame lacks 'arc'"),
        ({"file_path": None}, "a frame lacks 'file_path'"),
        ({"steering": "left"}, "could not convert string"),
        ({"car_pose": [1, 2]}, "cannot reshape|inhomogeneous"),
        ({"file_path": "images/other.png"}, "other.png"),
        ({"file_path": "images/small.png"}, "same shape"),
    ],
)
def test_damaged_ground_views_name_their_folder_and_what_to_do(tmp_path, change, words):
    folder = tmp_path / "outer_loop"
    for name, size in (("a", 8), ("b", 8), ("small", 4)):
        write_png(folder / "images" / f"{name}.png", np.zeros((size, 8, 3), np.uint8))
    whole = {"car_pose": [0.0, 0.0, 0.0], "arc": 0.0, "steering": 0.0}
    frames = [{"file_path": "images/a.png"} | whole, {"file_path": "images/b.png"} | whole]
    frames[1] = {key: value for key, value in (frames[1] | change).items() if value is not None}
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    with pytest.raises(
        UserError, match=rf"outer_loop: holds damaged ground views \(.*({words}).*\); delete the folder"
    ):
        load_views(folder)
