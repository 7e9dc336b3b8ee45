"""What a data set is said to hold and to lack."""

from dataclasses import replace

from carff.dataset_summary import limits, pictures_in_two_splits, summarise
from carff.states import build_state_table


def test_a_complete_data_set(tiny_data, tiny_table):
    assert summarise(tiny_data, tiny_table) == [
        "16 views of 4 states in 2 branches, 32 x 32 pixels",
        "cameras: 4 train, 0 val, 0 test",
        "note: 4 training cameras, few for a radiance field: expect wrong shapes, use dozens",
    ]


def test_pictures_that_the_encoder_cannot_read_are_noted(tiny_data):
    cropped = replace(tiny_data, images=tiny_data.images[:, :, :20], cameras=tiny_data.cameras.scaled(20, 32))
    assert any("not multiples of 32 pixels" in line for line in summarise(cropped, build_state_table(cropped)))


def test_k46_a_copied_picture_in_another_split_is_told(tiny_data, numeric_row):
    frames = tuple(replace(frame, split="test" if frame.camera == 2 else "train") for frame in tiny_data.frames)
    images = tiny_data.images.clone()
    images[2] = images[0]  # camera 2 shows in the first state what camera 0 shows
    wrong = 0
    for pictures, count in ((tiny_data.images, 0), (images, 1)):
        data = replace(tiny_data, frames=frames, images=pictures)
        wrong += abs(pictures_in_two_splits(data) - count)
        told = any("held-out pictures are equal" in line for line in summarise(data, build_state_table(data)))
        wrong += told != (count > 0)
    numeric_row("K46", "a training picture copied into the test views, and none: not told, or told for nothing", wrong)


def test_missing_pictures_are_named(tiny_data):
    part = tiny_data.select(list(range(1, len(tiny_data))))
    gone = tiny_data.frames[0]
    line = summarise(part, build_state_table(part))[2]
    assert line == f"1 (branch, step, camera) without a picture: {(gone.branch, gone.step, gone.camera)}"


def test_every_lack_has_a_sentence(tiny_data):
    first_steps = [row for row, frame in enumerate(tiny_data.frames) if frame.step == 0]
    bare = replace(tiny_data.select(first_steps), extras={})
    bare = replace(bare, frames=tuple(replace(frame, split="test") for frame in bare.frames))
    reasons = limits(build_state_table(bare))
    for word in ("split `train`", "train_mdn.py will refuse", "`actors`", "no decisions"):
        assert any(word in reason for reason in reasons), word
    assert len(reasons) == 4
