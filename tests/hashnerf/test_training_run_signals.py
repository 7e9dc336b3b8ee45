"""Whole training processes that are killed, interrupted and starved of disk, then started again."""

import json
import subprocess
import sys
from pathlib import Path

from hashnerf.checkpoints import checkpoint_steps

ROOT = Path(__file__).resolve().parents[2]

# A script as a user would run it; children of one process, so that torch is loaded once.
TRAINING = """
import json, os, random, resource, signal, sys, time
from pathlib import Path
import numpy, torch
import torch._dynamo  # an optimiser's first step loads it: here once, instead of in every child
from hashnerf.command_line import run_main
from hashnerf.random_state import seed_everything
from hashnerf.training_run import TrainingRun
torch.set_num_threads(1)
root, draw = Path(sys.argv[1]), random.Random(5)

def train(folder, steps=120, pause=0.0):
    seed_everything(11)
    nn = torch.nn
    model = nn.Sequential(nn.Linear(6, 8), nn.BatchNorm1d(8), nn.Dropout(0.1), nn.Linear(8, 1))
    optimizer = torch.optim.Adam(model.parameters(), 0.01)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.99)
    generator = torch.Generator().manual_seed(12)
    objects = {"model": model, "optimizer": optimizer, "schedule": schedule}
    with TrainingRun(folder, {"rate": 0.01}, steps, objects, {"rays": generator}, save_every=10) as run:
        for step in run.steps():
            x = torch.randn(16, 6, generator=generator) + torch.rand(1) + random.random() + float(numpy.random.rand())
            loss = (model(x) - x[:, :1]).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            run.log(step, loss=loss)
            time.sleep(pause)

def start(*arguments, before=lambda: None):
    child = os.fork()
    if child == 0:
        before()
        run_main(lambda: train(*arguments))
    return child

def end(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

def lines(folder):
    path = folder / "metrics.jsonl"
    return path.read_bytes().count(b"\\n") if path.exists() else 0

def wait_for_lines(folder, count):
    while lines(folder) < count:
        time.sleep(0.002)
"""


def run(body: str, folder: Path) -> subprocess.CompletedProcess:
    done = subprocess.run(
        [sys.executable, "-c", TRAINING + body, str(folder)], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert "done" in done.stdout, done.stderr
    return done


def losses(folder: Path) -> list[tuple[int, float]]:
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [(line["step"], line["loss"]) for line in lines]


def test_k01_killed_again_and_again_ends_with_the_same_bytes(tmp_path, numeric_row):
    """kill -9 at random moments, some of them inside a save: all that is saved equals an uninterrupted run's."""
    body = """
assert end(start(root / "whole")) == 0
kills = 0
while (target := lines(root / "parts") + draw.randint(1, 20)) < 120:
    child = start(root / "parts")
    wait_for_lines(root / "parts", target)
    time.sleep(0.02 * draw.random())
    os.kill(child, signal.SIGKILL)
    kills += end(child) == -signal.SIGKILL
assert end(start(root / "parts")) == 0
print(kills, "kills, done")
"""
    kills, different = int(run(body, tmp_path).stdout.split()[0]), 0
    assert kills >= 5
    for step in (110, 120):
        whole, parts = (tmp_path / run / "checkpoints" / f"{step:07d}" for run in ("whole", "parts"))
        different += (whole / "tensors.safetensors").read_bytes() != (parts / "tensors.safetensors").read_bytes()
    different += sum(a != b for a, b in zip(losses(tmp_path / "whole"), losses(tmp_path / "parts")))
    numeric_row("K01", f"{kills} kills of a training of 120 steps: files and losses that differ", different)
    assert [step for step, _ in losses(tmp_path / "parts")] == list(range(120))
    assert not [path for path in (tmp_path / "parts").rglob(".*") if path.name != ".lock"]


def test_k02_k08_signals_and_full_disks_cost_nothing_but_time(tmp_path, numeric_row):
    """Signals save and exit 130 or 143, a second one kills; files may not grow past a limit, then they may again."""
    body = """
for name, number, code in (("int", signal.SIGINT, 130), ("term", signal.SIGTERM, 143)):
    child = start(root / name, 20, 0.01)
    wait_for_lines(root / name, 6)
    told = time.monotonic()
    os.kill(child, number)
    assert end(child) == code
    print("waited", time.monotonic() - told)
child = start(root / "stuck", 20, 1000.0)
wait_for_lines(root / "stuck", 1)
os.kill(child, signal.SIGTERM)
time.sleep(0.2)  # the step sleeps on: Python resumes a sleep after the handler
os.kill(child, signal.SIGTERM)
assert end(child) == -signal.SIGTERM

for name, size in (("save", 15_000), ("log", 300)):
    assert end(start(root / name, 20, before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)))) == 2

for name in ("int", "term", "save", "log"):
    assert end(start(root / name, 20)) == 0
print("done")
"""
    done = run(body, tmp_path)
    error = done.stderr
    assert "stopped by SIGINT and saved after step" in error
    assert "stopped by SIGTERM and saved after step" in error
    assert "continuing after step" in error
    assert "once more to stop at once" in error
    assert "0000010: the checkpoint could not be written ([Errno 27] File too large)" in error
    assert (
        "metrics.jsonl: cannot be written (File too large); No checkpoint had been written yet: run the same" in error
    )
    assert "Traceback" not in error
    expected = losses(tmp_path / "int")
    assert [step for step, _ in expected] == list(range(20))
    for row, name in (("K08", "term"), ("K02", "save"), ("K02", "log")):
        different = sum(a != b for a, b in zip(losses(tmp_path / name), expected, strict=True))
        different += checkpoint_steps(tmp_path / name / "checkpoints")[-1] != 20
        numeric_row(row, f"stopped by '{name}' and started again: losses that differ", different)
    waits = [float(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("waited")]
    numeric_row("K08", "seconds from SIGINT or SIGTERM to the exit", max(waits), 10.0)
