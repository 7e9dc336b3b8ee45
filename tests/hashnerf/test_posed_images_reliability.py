"""Data sets as strangers bring them: what is wrong is named with its frame, what is odd but right loads as it is."""

import copy
import math
import os
import re
import resource
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from hashnerf.cameras import look_at
from hashnerf.errors import DataError
from hashnerf.posed_images import load_posed_images
from hashnerf.transforms_json import write_transforms
from tests.hashnerf.refusals import refuses

WIDTH, HEIGHT = 8, 6
BOX = [[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]]


def document_of(folder: Path, count: int, size: tuple[int, int] = (HEIGHT, WIDTH)) -> dict:
    """Writes `count` different pictures of a ring of cameras that look inward, and returns their transforms."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    frames = []
    for row in range(count):
        name = f"images/{row:04d}.png"
        shade = np.full((*size, 3), (row % 256, row // 256 * 40, 7), np.uint8)
        Image.fromarray(shade).save(folder / name)
        angle = 2 * math.pi * row / max(count, 3)
        pose = look_at((5 * math.cos(angle), 5 * math.sin(angle), 2.0), (0.0, 0.0, 0.5))
        frames.append({"file_path": name, "transform_matrix": pose.double().tolist(), "camera": row})
    document = {"fl_x": 7.0 * size[1] / WIDTH, "scene_box": BOX, "frames": frames}
    write_transforms(folder / "transforms.json", document)
    return document


def problems(folder: Path, document: dict) -> list[str]:
    """Every line of the one report about a data set; none if it loads."""
    write_transforms(folder / "transforms.json", document)
    try:
        load_posed_images(folder)
    except DataError as error:
        return error.problems
    return []


def test_k40_all_that_is_wrong_comes_in_one_report(tmp_path, numeric_row):
    document = document_of(tmp_path, 9)
    images = tmp_path / "images"
    (images / "0000.png").unlink()
    (images / "0001.png").write_bytes(b"")
    (images / "0002.png").write_text("no picture")
    (images / "0003.png").write_bytes((images / "0003.png").read_bytes()[:45])
    Image.new("I;16", (WIDTH, HEIGHT)).save(images / "0004.png")
    document["frames"][5]["file_path"] = "../out.png"
    document["frames"][6]["file_path"] = "images/0007.png"
    document["frames"][8]["camera"] = 7
    told = problems(tmp_path, document)
    sentences = {
        0: "does not exist",
        1: "is empty",
        2: "is not a readable",
        3: "damaged or truncated|not a readable",
        4: "16 bits",
        5: "leaves the data folder",
        7: "same picture file as frame 6",
        8: "same .branch, step, camera. as frame 7",
    }
    missing = [
        row
        for row, sentence in sentences.items()
        if not any(line.startswith(f"frame {row} (") and re.search(sentence, line) for line in told)
    ]
    print(told)
    numeric_row("K40", f"{len(sentences)} bad frames of 9, in one report: not told", len(missing))
    numeric_row("K40", "the same: lines about good frames", len(told) - len(sentences))


def test_k40_odd_names_load(tmp_path, numeric_row):
    names = ["A.PNG", "b c.png", "größe.png", "x.y.png", "-rf.png", "日本.jpg", "upper.JPG", "as.jpeg", "png.jpg"]
    document = document_of(tmp_path, len(names))
    for frame, name in zip(document["frames"], names):
        kind = "PNG" if name == "png.jpg" else None  # the bytes count, not the name
        Image.open(tmp_path / frame["file_path"]).save(tmp_path / name, format=kind, quality=100)
        frame["file_path"] = name
    told = problems(tmp_path, document)
    print(told)
    numeric_row("K40", f"{len(names)} names with blanks, accents, capitals: refused", len(told))


def test_k41_sizes_are_never_changed_in_silence(tmp_path, numeric_row):
    document = document_of(tmp_path, 4)
    Image.new("RGB", (WIDTH + 1, HEIGHT)).save(tmp_path / "images/0002.png")
    wrong = not any("all pictures need one size" in line and "frame 2" in line for line in problems(tmp_path, document))
    document["w"], document["h"] = WIDTH, HEIGHT
    stated = problems(tmp_path, document)
    wrong += not any("frame 2 (" in line and "the file is 9x6 but w and h say 8x6" in line for line in stated)
    numeric_row("K41", "one picture of another size, stated and not: taken in, or not named", wrong)


def test_k41_every_frame_may_have_a_lens_of_its_own(tmp_path, numeric_row):
    document = document_of(tmp_path, 3)
    document["frames"][1] |= {"fl_x": 9.0, "cx": 3.5}
    write_transforms(tmp_path / "transforms.json", document)
    cameras = load_posed_images(tmp_path).cameras
    off = (
        np.abs(cameras.focal[:, 0].numpy() - [7, 9, 7]).max() + np.abs(cameras.centre[:, 0].numpy() - [4, 3.5, 4]).max()
    )
    numeric_row("K41", "focal length and centre of one frame: pixels off", off)


def turned(change):
    """A change of the upper left 3x3 block."""

    def edit(pose):
        pose[:3, :3] = change(pose[:3, :3])
        return pose

    return edit


def put(row, column, value):
    def edit(pose):
        pose[row, column] = value
        return pose

    return edit


BAD_POSES = {
    "infinite integer": (lambda pose: [[10**400, *pose[0, 1:].tolist()], *pose[1:].tolist()], "too large"),
    "3x4": (lambda pose: pose[:3], "rows of the lengths"),
    "4x3": (lambda pose: pose[:, :3], "rows of the lengths"),
    "transposed": (lambda pose: pose.T, "transposed"),
    "last row": (put(3, 3, 2.0), "last row"),
    "mirrored": (turned(lambda r: r * [-1, 1, 1]), "mirror image"),
    "scaled by 1.01": (turned(lambda r: r * 1.01), "not rigid"),
    "sheared": (turned(lambda r: r + np.array([[0, 1e-2, 0], [0, 0, 0], [0, 0, 0]])), "not rigid"),
    "1e9 m away": (put(0, 3, 1e9), "1e\\+09 m from the origin"),
}


def test_k42_bad_poses_are_named_with_their_frame(tmp_path, numeric_row):
    good, wrong = document_of(tmp_path, 4), []
    for case, (change, sentence) in BAD_POSES.items():
        document = copy.deepcopy(good)
        pose = change(np.array(document["frames"][2]["transform_matrix"]))
        document["frames"][2]["transform_matrix"] = pose.tolist() if isinstance(pose, np.ndarray) else pose
        told = problems(tmp_path, document)
        wrong += [] if len(told) == 1 and re.match(rf"frame 2 \(.*{sentence}", told[0]) else [(case, told)]
    text = (tmp_path / "transforms.json").read_text()
    for token in ("NaN", "Infinity"):
        bad = text.replace('"transform_matrix": [\n    [\n', f'"transform_matrix": [\n    [\n     {token},\n', 1)
        (tmp_path / "transforms.json").write_text(bad)
        wrong += [] if refuses(f"the token {token} in line", load_posed_images, tmp_path) else [token]
    print(wrong)
    numeric_row(
        "K42", f"{len(BAD_POSES) + 2} poses: NaN, 3x4, mirrored, scaled, ...: taken in, or not named", len(wrong)
    )


def test_k42_poses_of_few_digits_are_made_rigid(tmp_path, numeric_row):
    document = document_of(tmp_path, 6)
    for frame in document["frames"]:
        frame["transform_matrix"] = np.array(frame["transform_matrix"]).astype(np.float16).astype(float).tolist()
    assert problems(tmp_path, document) == []
    turn = load_posed_images(tmp_path).cameras.pose[:, :3, :3].double()
    error = (turn.transpose(1, 2) @ turn - torch.eye(3)).abs().max()
    numeric_row("K42", "six poses stored in half precision: R'R from 1", float(error), 3e-7)


@pytest.mark.parametrize("case", ["all alike", "OpenCV axes"])
def test_k42_cameras_that_cannot_be_meant_are_refused(tmp_path, case, numeric_row):
    """Axes of another convention make every camera look away from the scene, which its box tells."""
    document = document_of(tmp_path, 6)
    first = copy.deepcopy(document["frames"][0]["transform_matrix"])
    for frame in document["frames"]:
        other = (np.array(frame["transform_matrix"]) * [1, -1, -1, 1]).tolist()
        frame["transform_matrix"] = first if case == "all alike" else other
    told = problems(tmp_path, document)
    sentence = {"all alike": "all cameras have the same pose", "OpenCV axes": "no camera sees it"}[case]
    numeric_row("K42", f"six cameras, {case}: taken in", not any(sentence in line for line in told))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_k43_very_few_pictures(tmp_path, count, numeric_row):
    document = document_of(tmp_path, count)
    told = problems(tmp_path, document)
    right = told == ["'frames' must be a list with at least one frame"] if count == 0 else told == []
    numeric_row("K43", f"{count} pictures: neither loaded nor told", not right)


def test_k43_splits_may_be_empty_or_everything(tmp_path, numeric_row):
    document, wrong = document_of(tmp_path, 4), 0
    for share in (0, 4):
        for row, frame in enumerate(document["frames"]):
            frame["split"] = "test" if row < share else "train"
        wrong += len(problems(tmp_path, document))
        posed = load_posed_images(tmp_path)
        wrong += (
            len(posed.split("test")) != share or len(posed.split("train")) != 4 - share or len(posed.split("val")) > 0
        )
    numeric_row("K43", "no test views, only test views: not loaded as told", wrong)


def test_k46_a_picture_or_a_camera_in_two_splits_is_named(tmp_path, numeric_row):
    document = document_of(tmp_path, 4)
    document["states"] = [{"branch": 0, "step": step} for step in (0, 1)]
    document["frames"][2] |= {"camera": 1, "step": 1, "split": "test"}
    document["frames"][3] |= {"file_path": "images/0000.png", "split": "test", "step": 1}
    told = problems(tmp_path, document)
    named = [
        any("camera 1 is in the splits test and train" in line for line in told),
        any("frame 3 (" in line and "same picture file as frame 0" in line for line in told),
    ]
    numeric_row("K46", "a camera in two splits, a file in two splits: not named", 2 - sum(named))


def in_a_process(work) -> float:
    """What `work` returns in a process of its own; its limits and its memory are not ours."""
    reader, writer = os.pipe()
    if os.fork() == 0:
        try:
            os.closerange(3, writer)  # what other tests have open is not ours either
            os.closerange(writer + 1, 4096)
            os.write(writer, str(float(work())).encode())
        finally:
            os._exit(0)
    os.wait()
    os.close(writer)
    with open(reader) as told:
        return float(told.read())


def test_k48_files_are_closed_and_large_pictures_let_go(tmp_path, numeric_row):
    """Pictures are shrunk as they are read: a set takes the memory of the small ones, whatever it weighs on disk."""
    count, size = 300, (300, 400)
    document_of(tmp_path, count, size)

    def growth() -> float:
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        loaded = len(load_posed_images(tmp_path, image_size=20))
        return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1000 if loaded == count else math.inf

    whole = count * size[0] * size[1] * 3 / 1e6
    inputs = f"{count} pictures (for time, not 1e5), 64 file descriptors, {whole:.0f} MB of pixels made small: MB taken"
    numeric_row("K48", inputs, in_a_process(growth), whole / 2)
