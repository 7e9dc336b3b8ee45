"""Loading a data set folder: what comes out of a good one, and the one report about a bad one."""

import copy
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hashnerf.cameras import camera_rays, look_at, project
from hashnerf.errors import DataError, UserError
from hashnerf.image_files import write_png
from hashnerf.posed_images import load_depth, load_posed_images, missing_views
from hashnerf.transforms_json import write_transforms

WIDTH, HEIGHT = 8, 6
ACTOR = {"branch": 1, "step": 0, "center": [1.0, 2.0, 0.5], "size": [4, 2, 1], "yaw": 0.0}


def _picture(row):
    return np.random.default_rng(row).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


@pytest.fixture
def folder(tmp_path):
    """Two branches, one step, three cameras (the last one for testing): six frames."""
    frames = []
    for branch in range(2):
        for camera in range(3):
            name = f"images/b{branch}_s0_c{camera}.png"
            write_png(tmp_path / name, _picture(len(frames)))
            frames.append(
                {
                    "file_path": name,
                    "transform_matrix": look_at((5.0, camera, 2.0), (0, 0, 1)).double().tolist(),
                    "branch": branch,
                    "step": 0,
                    "camera": camera,
                    "split": "test" if camera == 2 else "train",
                }
            )
    document = {
        "camera_model": "OPENCV",
        "w": WIDTH,
        "h": HEIGHT,
        "fl_x": 7.0,
        "fl_y": 7.5,
        "cx": 4.5,
        "cy": 3.0,
        "k1": -0.05,
        "scene_box": [[-10, -10, -1], [10, 10, 5]],
        "states": [{"branch": 0, "step": 0, "hazard": False}, {"branch": 1, "step": 0, "hazard": True}],
        "branches": ["absent", "present"],
        "actors": {"truck": [ACTOR]},
        "frames": frames,
    }
    write_transforms(tmp_path / "transforms.json", document)
    return tmp_path


def _edit(folder, change):
    path = folder / "transforms.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))  # lets NaN through, as other programs do


def _problems(folder, **options):
    with pytest.raises(DataError) as caught:
        load_posed_images(folder, **options)
    assert caught.value.source == str(folder / "transforms.json")
    return caught.value.problems


def test_a_good_folder_loads_whole(folder):
    posed = load_posed_images(folder)
    assert len(posed) == 6 and posed.images.shape == (6, HEIGHT, WIDTH, 3)
    assert all(np.array_equal(posed.images[row].numpy(), _picture(row)) for row in range(6))
    torch.testing.assert_close(posed.cameras.pose[4], look_at((5, 1, 2), (0, 0, 1)))
    assert posed.cameras.focal[0].tolist() == [7, 7.5] and posed.cameras.centre[0].tolist() == [4.5, 3]
    assert posed.cameras.distortion[0, 0] == pytest.approx(-0.05)
    assert posed.scene_box.tolist() == [[-10, -10, -1], [10, 10, 5]] and not posed.origin.any()
    assert posed.frames[4].branch == 1 and posed.frames[4].camera == 1 and posed.frames[4].depth_path is None
    assert set(posed.extras) == {"states", "branches", "actors"} and posed.extras["actors"]["truck"] == [ACTOR]


def test_splits_and_selections_keep_rows_together(folder):
    posed = load_posed_images(folder)
    test = posed.split("test")
    assert [frame.camera for frame in test.frames] == [2, 2] and len(test.cameras) == 2
    assert torch.equal(test.images[1], posed.images[5]) and torch.equal(test.cameras.pose[1], posed.cameras.pose[5])
    assert len(posed.split("val")) == 0
    assert [frame.camera for frame in posed.select([4, 0]).frames] == [1, 0]
    with pytest.raises(UserError, match="split 'training' is not one of train, val, test"):
        posed.split("training")


def test_shrinking_averages_areas_and_scales_the_lens(folder):
    full, small = load_posed_images(folder), load_posed_images(folder, image_size=4)
    blocks = full.images.float().reshape(6, 3, 2, 4, 2, 3).mean(dim=(2, 4))
    assert small.images.shape == (6, 3, 4, 3)
    assert (small.images.float() - blocks).abs().max() <= 0.5
    assert (small.cameras.width, small.cameras.height) == (4, 3)
    torch.testing.assert_close(small.cameras.focal * 2, full.cameras.focal)
    torch.testing.assert_close(small.cameras.centre * 2, full.cameras.centre)


def test_shrinking_by_a_fraction_weighs_cut_pixels_by_their_area(folder):
    # 8 -> 3 columns, 6 -> 2 rows: column 0 covers source columns 0, 1 and two thirds of 2; row 0 covers rows 0, 1, 2.
    small = load_posed_images(folder, image_size=3)
    source = _picture(0).astype(float)[:3].mean(axis=0)
    expected = (source[0] + source[1] + source[2] * 2 / 3) / (8 / 3)
    assert np.abs(small.images[0, 0, 0].numpy() - expected).max() <= 0.51
    assert small.cameras.focal[0].tolist() == pytest.approx([7 * 3 / 8, 7.5 * 2 / 6])


@pytest.mark.parametrize("image_size, sentence", [(9, "would enlarge pictures of width 8"), (0, "at least 1 pixel")])
def test_a_useless_image_size_is_refused(folder, image_size, sentence):
    with pytest.raises(UserError, match=sentence):
        load_posed_images(folder, image_size=image_size)


def test_a_plain_file_loads_with_defaults(folder):
    def strip(document):
        frames = [{key: frame[key] for key in ("file_path", "transform_matrix")} for frame in document["frames"]]
        frames[0]["file_path"] = "./images/b0_s0_c0"
        document.clear()
        document.update({"camera_angle_x": 1.0, "frames": frames})

    _edit(folder, strip)
    posed = load_posed_images(folder)
    assert [(frame.branch, frame.step, frame.camera, frame.split) for frame in posed.frames] == [
        (0, 0, row, "train") for row in range(6)
    ]
    assert posed.cameras.is_pinhole and posed.cameras.centre[0].tolist() == [4, 3]
    assert posed.cameras.focal[0].tolist() == pytest.approx([4 / np.tan(0.5)] * 2)
    assert (posed.scene_box[0] < posed.cameras.pose[:, :3, 3].amin(0)).all() and posed.extras == {}


def test_a_lens_may_differ_by_frame(folder):
    _edit(folder, lambda document: document["frames"][3].update({"fl_x": 9.0, "k1": 0.0}))
    cameras = load_posed_images(folder).cameras
    assert cameras.focal[:, 0].tolist() == [7, 7, 7, 9, 7, 7]
    assert (cameras.distortion[:, 0] != 0).tolist() == [True, True, True, False, True, True]


def test_map_coordinates_are_moved_to_an_origin_before_rounding(folder):
    near = load_posed_images(folder)
    shift = np.array([500_000.0, 4_649_776.0, 35.0])

    def move(document):
        document["scene_box"] = (np.array(document["scene_box"]) + shift).tolist()
        document["actors"]["truck"][0]["center"] = (np.array(ACTOR["center"]) + shift).tolist()
        for frame in document["frames"]:
            frame["transform_matrix"] = np.array(frame["transform_matrix"])
            frame["transform_matrix"][:3, 3] += shift
            frame["transform_matrix"] = frame["transform_matrix"].tolist()

    _edit(folder, move)
    far = load_posed_images(folder)
    back = torch.from_numpy(shift) - far.origin  # what is left of the shift inside the loaded set
    assert far.origin.dtype == torch.float64 and back.abs().max() <= 10
    torch.testing.assert_close(far.cameras.pose[:, :3, 3].double(), near.cameras.pose[:, :3, 3].double() + back)
    torch.testing.assert_close(far.scene_box.double(), near.scene_box.double() + back)
    centre = torch.tensor(far.extras["actors"]["truck"][0]["center"], dtype=torch.float64)
    torch.testing.assert_close(centre, torch.tensor(ACTOR["center"], dtype=torch.float64) + back)
    index, pixel = torch.arange(6), torch.rand(6, 2) * torch.tensor([WIDTH, HEIGHT])
    rays = camera_rays(near.cameras, index, pixel)
    again, _ = project(far.cameras, index, rays.origins + 5 * rays.directions + back.float())
    assert (again - pixel).abs().max() <= 1e-3


def test_missing_views_are_listed(folder):
    assert missing_views(load_posed_images(folder)) == []
    _edit(folder, lambda document: document["frames"].pop(4))
    assert missing_views(load_posed_images(folder)) == [(1, 0, 1)]


def test_depth_is_read_in_metres(folder):
    depth = np.arange(48, dtype=np.uint16).reshape(6, 8) * 1000
    for row in range(6):
        write_png(folder / f"depth/{row}.png", depth + row)
    _edit(folder, lambda document: [f.update(depth_path=f"depth/{r}.png") for r, f in enumerate(document["frames"])])
    posed = load_posed_images(folder)
    full, small = load_depth(posed), load_depth(load_posed_images(folder, image_size=4))
    assert full[3, 0, 1] == pytest.approx(1.003) and full[0, 0, 0] == 0 and full.shape == (6, 6, 8)
    # the centre of small pixel (0, 1) is at 3.0 of 8 columns and 1.0 of 6 rows: source column 3, row 1
    assert float(small[0, 0, 1]) == depth[1, 3] / 1000
    write_png(folder / "depth/2.png", depth[:5])
    (folder / "depth/4.png").unlink()
    missing = replace(posed, frames=(*posed.frames[:5], replace(posed.frames[5], depth_path=None)))
    with pytest.raises(DataError) as caught:
        load_depth(missing)
    sentences = ["b0_s0_c2.png: depth of 8x5 does not fit", "b1_s0_c1.png: 'depth/4.png' does not", "has no depth_path"]
    assert all(part in line for part, line in zip(sentences, caught.value.problems, strict=True))


BAD_FRAMES = {
    "branch": ({"branch": -1}, "branch = -1 must be an integer from 0 up"),
    "step": ({"step": 0.5}, "step = 0.5 must be an integer"),
    "camera": ({"camera": True}, "camera = True must be an integer"),
    "huge": ({"camera": 10**12}, "camera = 1000000000000 must be an integer"),
    "split": ({"split": "training"}, "split = 'training' is not one of train, val, test"),
    "splits": ({"split": ["train"]}, "is not one of train, val, test"),
    "pose": ({"transform_matrix": [[1, 0], [0, 1]]}, "transform_matrix has rows of the lengths [2, 2]"),
    "scaled pose": ({"transform_matrix": [[2.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "is not rigid"),
    "path": ({"file_path": "../x.png"}, "'../x.png' leaves the data folder"),
    "absolute": ({"file_path": "/etc/passwd"}, "'/etc/passwd' leaves the data folder"),
    "number": ({"file_path": 7}, "the path 7 is not a file name"),
    "missing": ({"file_path": "images/none.png"}, "'images/none.png' does not exist"),
    "depth": ({"depth_path": "depth/none.png"}, "depth_path: 'depth/none.png' does not exist"),
    "size": ({"w": 9}, "the file is 8x6 but w and h say 9x6"),
    "swapped": ({"w": 6, "h": 8}, "the file is 8x6 but w and h say 6x8"),
    "size type": ({"w": "8"}, "the file is 8x6 but w and h say 8x6"),
    "focal": ({"fl_x": -7}, "fl_x = -7 must be above zero"),
    "centre": ({"cx": 80}, "cx = 80 lies outside the image of 8x6"),
    "fold": ({"k1": -0.9}, "folds back inside the image"),
    "same view": ({"branch": 0, "camera": 2}, "has the same (branch, step, camera) as frame 2"),
    "same file": ({"file_path": "images/../images/b0_s0_c0.png"}, "has the same picture file as frame 0"),
    "leak": ({"split": "val"}, "camera 1 is in the splits train and val; each camera belongs to one split"),
}
ROWS = {"scaled pose": "N84", "swapped": "N121", "size": "N121", "focal": "N121", "centre": "N121"}


@pytest.mark.parametrize("case", sorted(BAD_FRAMES))
def test_n84_n121_a_bad_frame_is_named(folder, case, numeric_row):
    change, sentence = BAD_FRAMES[case]
    _edit(folder, lambda document: document["frames"][4].update(change))
    problems = _problems(folder)
    assert any(sentence in problem for problem in problems), problems
    unnamed = not any("frame 4 (" in problem or "camera 1" in problem for problem in problems)
    assert not unnamed
    if case in ROWS:
        numeric_row(ROWS[case], f"{case} of a frame: not named with its frame", unnamed)


@pytest.mark.parametrize(
    "damage, sentence",
    [
        (lambda path: path.write_bytes(b""), "b1_s0_c1.png is empty (0 bytes)"),
        (lambda path: path.write_bytes(path.read_bytes()[:100]), "b1_s0_c1.png is damaged or truncated"),
        (lambda path: path.write_text("no picture"), "b1_s0_c1.png is not a readable PNG or JPEG"),
        (lambda path: (path.unlink(), os.mkfifo(path)), "is not a regular file"),
        (lambda path: (path.unlink(), path.mkdir()), "is not a regular file"),
        (lambda path: (path.unlink(), path.symlink_to("/etc/hostname")), "leaves the data folder"),
        (lambda path: write_png(path, np.zeros((6, 9, 3), np.uint8)), "the file is 9x6 but w and h say 8x6"),
        (lambda path: write_png(path, np.zeros((6, 8), np.uint16)), "b1_s0_c1.png has 16 bits a channel"),
    ],
)
def test_a_bad_picture_is_named_with_its_frame(folder, damage, sentence):
    damage(folder / "images" / "b1_s0_c1.png")
    problems = _problems(folder)
    assert problems[0].startswith("frame 4 (images/b1_s0_c1.png): ") and sentence in problems[0]


def test_pictures_of_several_sizes_are_reported_without_stated_sizes(folder):
    write_png(folder / "images" / "b1_s0_c1.png", np.zeros((6, 9, 3), np.uint8))
    _edit(folder, lambda document: (document.pop("w"), document.pop("h")))
    (problem,) = _problems(folder)
    assert "all pictures need one size" in problem and "9x6 in frame 4" in problem and "8x6 in frame 0" in problem


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda d: d.update(frames=[]), "'frames' must be a list with at least one frame"),
        (lambda d: d.pop("frames"), "'frames' must be a list with at least one frame"),
        (lambda d: d.update(frames={"0": {}}), "'frames' must be a list with at least one frame"),
        (lambda d: d.update(Cx=d.pop("cx")), "the key 'Cx' is unknown; did you mean 'cx'?"),
        (lambda d: d["frames"][2].update(Camera_angle_x=1.0), "did you mean 'camera_angle_x'?"),
        (lambda d: d.update(branch_weight=[1.0, 1.0]), "'branch_weight' is unknown; did you mean 'branch_weights'?"),
        (lambda d: d.update({"scene-box": d.pop("scene_box")}), "'scene-box' is unknown; did you mean 'scene_box'?"),
        (lambda d: d["frames"].append("images/x.png"), "frame 6: must be an object with file_path"),
        (
            lambda d: d.update(fl_x=0),
            "frame 0 (images/b0_s0_c0.png): fl_x = 0 must be above zero (pixels) (the same in 5",
        ),
        (lambda d: d.update(camera_model="FISHEYE"), "camera_model 'FISHEYE' is not supported"),
        (lambda d: d.update(scene_box=[[0, 0, 0], [0, 1, 1]]), "scene_box"),
        (
            lambda d: d.update(scene_box=[[900, 900, 0], [901, 901, 1]]),
            "901, 1]]: no camera sees it; give it",
        ),
        (lambda d: d["states"].append({"branch": 5, "step": 0}), "states[2]: branch 5 step 0 has no frame"),
        (lambda d: d["actors"]["truck"].append({**ACTOR, "step": 3}), "actors.truck[1] is at branch 1 step 3"),
        (
            lambda d: [
                f.update(transform_matrix=copy.deepcopy(d["frames"][0]["transform_matrix"])) for f in d["frames"]
            ],
            "all cameras have the same pose",
        ),
    ],
)
def test_n123_a_bad_document_is_named(folder, change, sentence, numeric_row):
    _edit(folder, change)
    (problem,) = _problems(folder)
    assert sentence in problem
    if "at least one frame" in sentence:
        numeric_row("N123", "no frame at all: not named", sentence not in problem)


def test_keys_of_other_tools_load(folder):
    def other_tools(document: dict) -> None:
        document.update(aabb_scale=16, applied_transform=[], applied_scale=1.0, ply_file_path="x.ply", offset=[0, 0, 0])
        document.update(n_frames=6, train_filenames=[], orientation_override="none", integer_depth_scale=0.001)
        for frame in document["frames"]:
            pose = frame["transform_matrix"]
            frame.update(transform_matrix_start=pose, transform_matrix_end=pose, rolling_shutter=[0, 0, 0, 0])
            frame.update(sharpness=30.0, colmap_im_id=3, mask_path="m.png", depth_file_path="d.png", time=0.5)

    _edit(folder, other_tools)
    assert len(load_posed_images(folder)) == 6


def test_misspelled_frames_are_recognised(folder):
    _edit(folder, lambda document: document.update(frame=document.pop("frames")))
    assert "the key 'frame' is unknown; did you mean 'frames'?" in _problems(folder)


def test_every_problem_comes_in_one_report(folder):
    (folder / "images" / "b0_s0_c0.png").write_bytes(b"")
    (folder / "images" / "b0_s0_c1.png").unlink()

    def change(document):
        document["frames"][2]["transform_matrix"][0][0] = 3.0
        document["frames"][3]["split"] = "tset"
        document["scene_box"] = [[0, 0, 0]]

    _edit(folder, change)
    problems = _problems(folder)
    expected = ["frame 0 ", "frame 1 ", "frame 2 ", "frame 3 ", "scene_box"]
    assert len(problems) == 5 and all(problem.startswith(start) for problem, start in zip(problems, expected))


def test_a_file_name_cannot_break_the_report_into_lines(folder):
    _edit(folder, lambda document: document["frames"][4].update(file_path="a\n\x1b[31mb.png"))
    (problem,) = _problems(folder)
    assert problem.startswith("frame 4 (a??[31mb.png): ") and problem.isprintable()


def test_a_missing_folder_and_a_file_with_nan_are_named(folder):
    with pytest.raises(UserError, match=r"nowhere/transforms.json: not found"):
        load_posed_images(folder / "nowhere")
    _edit(folder, lambda document: document["frames"][0]["transform_matrix"][0].__setitem__(3, float("nan")))
    with pytest.raises(UserError, match="the token NaN in line 1 is not JSON"):
        load_posed_images(folder)


def test_one_camera_in_two_states_and_one_image_alone_are_enough(folder):
    _edit(folder, lambda document: document.update(frames=document["frames"][0:4:3]))
    assert [frame.branch for frame in load_posed_images(folder).frames] == [0, 1]
    _edit(folder, lambda document: [document.update(frames=document["frames"][:1], states=None, actors=None)])
    assert len(load_posed_images(folder)) == 1


def test_the_example_in_the_documentation_loads(tmp_path):
    page = (Path(__file__).parents[2] / "data" / "README.md").read_text(encoding="utf-8")
    document = json.loads(page.split("```json")[1].split("```")[0])
    write_transforms(tmp_path / "transforms.json", document)
    for frame in document["frames"]:
        write_png(tmp_path / frame["file_path"], np.zeros((480, 640, 3), np.uint8))
    posed = load_posed_images(tmp_path)
    # Both stand 1.5 m up and look along +x: 10 m ahead is the image centre, and 1 m left of that is 50 pixels left.
    pixel, depth = project(posed.cameras, torch.tensor([0, 4]), torch.tensor([[10.0, 0, 1.5], [15.0, 1, 1.5]]))
    torch.testing.assert_close(pixel, torch.tensor([[320.0, 240.0], [270.0, 240.0]]))
    assert depth.tolist() == [10, 10] and missing_views(posed) == []
