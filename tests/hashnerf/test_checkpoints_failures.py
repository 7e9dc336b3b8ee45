"""Checkpoints when the machine fails: full disks, size limits, lost bytes, refused deletions, kill -9."""

import io
import logging
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from hashnerf import checkpoints
from hashnerf.checkpoints import checkpoint_steps, load_checkpoint, save_checkpoint, sweep_leftovers
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[2]


def save_steps(folder: Path, *steps: int, keep: int = 2) -> None:
    for step in steps:
        save_checkpoint(folder, step, {"a": torch.full((64,), float(step))}, {"step": step}, keep)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


class Refusing:
    """A stand-in for a system call that fails at its nth use with `No space left on device`."""

    def __init__(self, call, at: int):
        self.call, self.left = call, at

    def __call__(self, *arguments, **options):
        self.left -= 1
        if self.left < 0:
            raise OSError(28, "No space left on device")
        return self.call(*arguments, **options)


def lost_or_left_over(folder: Path) -> int:
    """1 if no checkpoint loads after the next start's sweep, and 1 for each leftover."""
    sweep_leftovers(folder)
    return (load_checkpoint(folder).step not in (10, 20)) + sum(name.startswith(".") for name in names(folder))


def test_k02_a_full_disk_leaves_the_old_checkpoint(tmp_path, monkeypatch, numeric_row):
    worst = 0
    for call, at in [("fsync", n) for n in range(5)] + [("rename", 0)]:
        folder = tmp_path / f"{call}{at}"
        save_steps(folder, 10)
        with monkeypatch.context() as patch, pytest.raises(UserError, match=r"0000020.*No space left on device"):
            patch.setattr(os, call, Refusing(getattr(os, call), at))
            save_steps(folder, 20)
        worst += lost_or_left_over(folder)
    numeric_row("K02", "ENOSPC at each of 5 fsyncs and the rename: lost or left over", worst)


class Filling(io.FileIO):
    """A file on a disk with room for `room` bytes."""

    room = 0

    def write(self, data) -> int:
        super().write(data[: self.room])
        if len(data) > self.room:
            raise OSError(28, "No space left on device")
        return len(data)


def test_k02_a_disk_that_fills_at_any_byte_leaves_the_old_checkpoint(tmp_path, monkeypatch, numeric_row):
    worst, rooms = 0, (0, 1, 8, 200, 300)
    for room in rooms:
        folder = tmp_path / str(room)
        save_steps(folder, 10)
        with monkeypatch.context() as patch, pytest.raises(UserError, match=r"0000020.*No space left on device"):
            patch.setattr(Filling, "room", room)
            patch.setattr(checkpoints, "open", Filling, raising=False)
            save_steps(folder, 20)
        assert checkpoint_steps(folder) == [10]
        worst += lost_or_left_over(folder)
    numeric_row("K02", f"room for {rooms} bytes of a file: lost or left over", worst)


def test_k02_a_size_limit_leaves_the_old_checkpoint(tmp_path, numeric_row):
    """A process whose files may not grow past 20 kB fails in the middle of the tensor file."""
    save_steps(tmp_path, 10)
    code = (
        "import resource, sys, torch\nfrom pathlib import Path\nfrom hashnerf.checkpoints import save_checkpoint\n"
        "from hashnerf.command_line import run_main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        "run_main(lambda: save_checkpoint(Path(sys.argv[1]), 20, {'a': torch.zeros(100_000)}, {}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert names(tmp_path) == {"0000010", "last"}
    numeric_row("K02", "files may not pass 20 kB (exit 2): lost or left over", lost_or_left_over(tmp_path))


def test_k03_a_silent_short_write_is_noticed(tmp_path, monkeypatch, numeric_row):
    save_steps(tmp_path, 10)
    write = checkpoints._write_folder

    def lossy(folder, contents):
        write(folder, {name: data[:-1] if name == "tensors.safetensors" else data for name, data in contents.items()})

    monkeypatch.setattr(checkpoints, "_write_folder", lossy)
    with pytest.raises(UserError, match=r"tensors\.safetensors is \d+ bytes long instead of"):
        save_steps(tmp_path, 20)
    assert names(tmp_path) == {"0000010", "last"}
    numeric_row("K03", "a byte less than was written: lost or left over", lost_or_left_over(tmp_path))


def test_k03_folders_that_cannot_be_written_are_told(tmp_path, monkeypatch, numeric_row):
    """No case may pass for saved: a file in the folder's place, a refusing folder, and one that vanishes in a save."""

    def refuse(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    def vanish(folder, contents):
        shutil.rmtree(folder.parent)

    (tmp_path / "file").write_text("")
    changes = {
        "file": (tmp_path / "file", None, None, None),
        "below a file": (tmp_path / "file" / "below", None, None, None),
        "no folder may be made": (tmp_path / "mkdir", os, "mkdir", refuse),
        "no file may be made": (tmp_path / "open", checkpoints, "open", refuse),
        "gone while it is written": (tmp_path / "gone", checkpoints, "_write_folder", vanish),
    }
    taken_for_saved = []
    for case, (folder, owner, name, stand_in) in changes.items():
        with monkeypatch.context() as patch:
            if owner is not None:
                patch.setattr(owner, name, stand_in, raising=False)
            try:
                save_steps(folder, 1)
                taken_for_saved.append(case)
            except UserError as error:
                assert "could not be written" in str(error), case
        assert checkpoint_steps(folder) == []
    print(taken_for_saved)
    numeric_row("K03", f"{', '.join(changes)}: taken for saved", len(taken_for_saved))


def test_k03_a_folder_deleted_between_two_saves_is_made_again(tmp_path, numeric_row):
    save_steps(tmp_path / "run", 10)
    shutil.rmtree(tmp_path / "run")
    save_steps(tmp_path / "run", 20)
    numeric_row("K03", "folder deleted between two saves: lost or left over", lost_or_left_over(tmp_path / "run"))


def test_k10_failed_deletion_and_failed_link_do_not_end_training(tmp_path, monkeypatch, caplog, numeric_row):
    save_steps(tmp_path, 10, keep=1)

    def refuse(*arguments, ignore_errors=False):
        if not ignore_errors:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(shutil, "rmtree", refuse)
    monkeypatch.setattr(os, "symlink", refuse)
    with caplog.at_level(logging.WARNING):
        save_steps(tmp_path, 20, keep=1)
    assert ["last could not be updated" in caplog.messages[0], "deleted" in caplog.messages[1]] == [True, True]
    numeric_row("K10", "a deletion that fails: good checkpoints lost", load_checkpoint(tmp_path).step != 20)


def test_k10_nothing_is_deleted_before_the_new_one_is_verified(tmp_path, monkeypatch, numeric_row):
    save_steps(tmp_path, 10, keep=1)
    read, present = checkpoints._read_folder, []

    def watched(folder, step):
        present.append(checkpoint_steps(tmp_path))
        return read(folder, step)

    monkeypatch.setattr(checkpoints, "_read_folder", watched)
    save_steps(tmp_path, 20, keep=1)
    assert checkpoint_steps(tmp_path) == [20]
    numeric_row("K10", "keep 1: gone before the new one was read back", sum(10 not in steps for steps in present))
    assert present


class Killed(BaseException):
    """Stands for kill -9: no handler of errors may mend anything."""


@pytest.mark.parametrize("call", ["symlink", "replace"])
def test_k13_a_kill_around_the_swap_of_last_leaves_a_link_that_leads_to_a_checkpoint(
    tmp_path, monkeypatch, call, numeric_row
):
    worst = 0
    for after in (False, True):
        folder = tmp_path / str(after)
        save_steps(folder, 10, keep=1)
        whole = getattr(os, call)

        def killed(*arguments, after=after, whole=whole):
            if after:
                whole(*arguments)
            raise Killed

        with monkeypatch.context() as patch, pytest.raises(Killed):
            patch.setattr(os, call, killed)
            save_steps(folder, 20, keep=1)
        worst += not (folder / "last" / "manifest.json").is_file()
        worst += lost_or_left_over(folder) + (load_checkpoint(folder).step != 20)
        worst += not (folder / "last" / "manifest.json").is_file()
    numeric_row("K13", f"killed before and after os.{call}: dangling, lost or left over", worst)


KILLER = """
import os, random, shutil, signal, sys, time, torch
from pathlib import Path
from hashnerf.checkpoints import checkpoint_steps, load_checkpoint, save_checkpoint, sweep_leftovers
torch.set_num_threads(1)
folder, draw, wrong = Path(sys.argv[1]), random.Random(1), 0
for _ in range(15):
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        for step in range(1, 1_000_000):
            save_checkpoint(folder, step, {"a": torch.full((4_000_000,), float(step))}, {"step": step})
            os.write(writer, b"x")
    os.close(writer)
    os.read(reader, 1)
    time.sleep(draw.random() * 0.3)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    said = 1 + len(os.read(reader, 1000))
    os.close(reader)
    sweep_leftovers(folder)
    step, tensors, state = load_checkpoint(folder)
    good = step >= said and state == {"step": step} and bool((tensors["a"] == step).all())
    good &= len(checkpoint_steps(folder)) <= 3 and (folder / "last" / "manifest.json").is_file()
    good &= not [path for path in folder.iterdir() if path.name.startswith(".")]
    wrong += not good
    shutil.rmtree(folder)
print(wrong)
"""


def test_k01_kill_9_while_saving_16_megabytes(tmp_path, numeric_row):
    """Killed at random moments of its saves: what was reported as saved loads, and nothing else piles up."""
    done = subprocess.run(
        [sys.executable, "-c", KILLER, str(tmp_path / "run")], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    numeric_row("K01", "15 kills (for time, not 50) of saves of 16 MB: lost, dangling or left over", int(done.stdout))


def test_saving_does_not_hold_many_copies(tmp_path):
    """Peak memory grows by a few times the tensors, not by an amount that depends on earlier saves."""
    data = {"a": torch.zeros(4_000_000)}  # 16 MB
    for step in range(1, 4):
        save_checkpoint(tmp_path, step, data, {})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for step in range(4, 10):
        save_checkpoint(tmp_path, step, data, {})
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kilobytes
