"""Checkpoints when the machine fails: full disks, size limits, lost bytes, refused deletions, kill -9."""

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


@pytest.mark.parametrize(("call", "at"), [("fsync", n) for n in range(5)] + [("rename", 0)])
def test_a_full_disk_leaves_the_old_checkpoint(tmp_path, monkeypatch, call, at):
    save_steps(tmp_path, 10)
    monkeypatch.setattr(os, call, Refusing(getattr(os, call), at))
    with pytest.raises(UserError, match=r"0000020.*No space left on device"):
        save_steps(tmp_path, 20)
    monkeypatch.undo()
    sweep_leftovers(tmp_path)
    assert load_checkpoint(tmp_path).step in (10, 20)
    assert not [name for name in names(tmp_path) if name.startswith(".")]


def test_a_size_limit_leaves_the_old_checkpoint(tmp_path):
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
    assert load_checkpoint(tmp_path).step == 10


def test_a_silent_short_write_is_noticed(tmp_path, monkeypatch):
    save_steps(tmp_path, 10)
    write = checkpoints._write_folder

    def lossy(folder, contents):
        write(folder, {name: data[:-1] if name == "tensors.safetensors" else data for name, data in contents.items()})

    monkeypatch.setattr(checkpoints, "_write_folder", lossy)
    with pytest.raises(UserError, match=r"tensors\.safetensors is \d+ bytes long instead of"):
        save_steps(tmp_path, 20)
    assert names(tmp_path) == {"0000010", "last"}


def test_unusable_folders(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="could not be written"):
        save_steps(tmp_path / "file", 1)
    with pytest.raises(UserError, match="could not be written"):
        save_steps(tmp_path / "file" / "below", 1)
    assert checkpoint_steps(tmp_path / "file") == []


def test_failed_deletion_and_failed_link_do_not_end_training(tmp_path, monkeypatch, caplog):
    save_steps(tmp_path, 10, keep=1)

    def refuse(*arguments, ignore_errors=False):
        if not ignore_errors:
            raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(shutil, "rmtree", refuse)
    monkeypatch.setattr(os, "symlink", refuse)
    with caplog.at_level(logging.WARNING):
        save_steps(tmp_path, 20, keep=1)
    assert ["last could not be updated" in caplog.messages[0], "deleted" in caplog.messages[1]] == [True, True]
    assert load_checkpoint(tmp_path).step == 20


KILLER = """
import os, random, shutil, signal, sys, time, torch
from pathlib import Path
from hashnerf.checkpoints import checkpoint_steps, load_checkpoint, save_checkpoint, sweep_leftovers
torch.set_num_threads(1)
folder, draw = Path(sys.argv[1]), random.Random(1)
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
    assert step >= said and state == {"step": step} and bool((tensors["a"] == step).all()), (said, step)
    assert len(checkpoint_steps(folder)) <= 3 and (folder / "last" / "manifest.json").is_file()
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    shutil.rmtree(folder)
print("15 of 15")
"""


def test_kill_9_while_saving_16_megabytes(tmp_path):
    """Killed at random moments of its saves: what was reported as saved loads, and nothing else piles up."""
    done = subprocess.run(
        [sys.executable, "-c", KILLER, str(tmp_path / "run")], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.stdout == "15 of 15\n", done.stderr


def test_saving_does_not_hold_many_copies(tmp_path):
    """Peak memory grows by a few times the tensors, not by an amount that depends on earlier saves."""
    data = {"a": torch.zeros(4_000_000)}  # 16 MB
    for step in range(1, 4):
        save_checkpoint(tmp_path, step, data, {})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for step in range(4, 10):
        save_checkpoint(tmp_path, step, data, {})
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kilobytes
