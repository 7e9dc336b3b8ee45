"""A training run among hostile names, deleted folders, odd clocks and terminals."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from hashnerf.errors import UserError
from hashnerf.training_run import TrainingRun, begun_config, run_folder

ROOT = Path(__file__).resolve().parents[2]


def run(folder: Path, total: int = 4, **options) -> TrainingRun:
    return TrainingRun(folder, {"rate": 0.5}, total, {"model": torch.nn.Linear(2, 1)}, **options)


@pytest.mark.parametrize("name", ["a", "fast", "fast-2", "2026.01.02_x", "A" * 64])
def test_good_run_names(tmp_path, name):
    assert run_folder(tmp_path, name) == tmp_path / name


BAD_NAMES = [
    *(
        "",
        ".",
        "..",
        "../../x",
        "-rf",
        "a/b",
        "a\\b",
        "a\nb",
        "a\n",
        "a b",
        "a\0b",
        "CON",
        "nul.txt",
        "com1",
        "x.",
        ".x",
    ),
    *("A" * 65, "ä", "~", "$HOME"),
]


def test_k36_bad_run_names(tmp_path, numeric_row):
    accepted = []
    for name in BAD_NAMES:
        try:
            accepted.append(run_folder(tmp_path, name))
        except UserError as error:
            assert "cannot name a run" in str(error) and str(error).isprintable()
    print(accepted)
    numeric_row("K36", f"{len(BAD_NAMES)} names such as ../../x, -rf, CON, empty: accepted", len(accepted))


def test_k03_a_run_folder_that_is_deleted_ends_the_run_in_words(tmp_path, numeric_row):
    """The metrics notice it at once; without them the next save makes the folder anew and is whole."""
    went_on = []
    with pytest.raises(UserError, match=r"metrics.jsonl: cannot be written"), run(tmp_path / "logged") as logged:
        for step in logged.steps():
            shutil.rmtree(tmp_path / "logged")
            logged.log(step, loss=1.0)
            went_on.append(step)
    with run(tmp_path / "silent", save_every=2) as silent:
        for step in silent.steps():
            if step == 1:
                shutil.rmtree(tmp_path / "silent")
    with run(tmp_path / "silent") as again:
        unsaved = again.total_steps - again.completed
    numeric_row("K03", "run folder deleted while it trains: steps without a word or a save", len(went_on) + unsaved)


def test_k27_a_clock_that_is_set_back_changes_no_duration(tmp_path, monkeypatch, numeric_row):
    clock = iter(range(10**9, 0, -3600))
    monkeypatch.setattr(time, "time", lambda: float(next(clock)))
    with run(tmp_path) as going:
        for step in going.steps():
            going.log(step)
    seconds = [json.loads(line)["seconds"] for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    falls = sum(not 0 <= b - a < 60 for a, b in zip([0.0, *seconds], seconds))
    numeric_row("K27", "a clock that falls an hour at every look: durations that are wrong", falls)


SCRIPT = """
import sys
from dataclasses import dataclass
from pathlib import Path
import torch
from hashnerf.command_line import parse_config, run_main
from hashnerf.training_run import TrainingRun, begun_config

@dataclass(frozen=True)
class Config:
    rate: float = 1.5
    folder: Path = Path("run")

def main():
    config = parse_config(Config)
    model = torch.nn.Linear(2, 1)
    with TrainingRun(config.folder, config, 3, {"model": model}) as run:
        for step in run.steps():
            run.log(step, loss=config.rate / 4)
    print("Gr\u00fc\u00dfe, \u03c3 = %.2f" % config.rate)

run_main(main)
"""


def test_k27_other_languages_times_and_terminals_give_the_same_metrics(tmp_path, numeric_row):
    """A German decimal comma, a far time zone, a terminal without UTF-8, no terminal and no standard error at all."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    odd = {"LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8", "TZ": "Pacific/Kiritimati", "PYTHONIOENCODING": "ascii"}
    found = {}
    for name, changes in (("plain", {}), ("odd", odd)):
        command = [sys.executable, "-c", SCRIPT, "--rate", "1.25", "--folder", str(tmp_path / name)]
        shell = ["sh", "-c", 'exec "$@" 2>&-', "sh"] if changes else []
        done = subprocess.run([*shell, *command], env=environment | changes, capture_output=True, timeout=120)
        assert done.returncode == 0, done.stderr
        lines = [json.loads(line) for line in (tmp_path / name / "metrics.jsonl").read_text().splitlines()]
        config = (tmp_path / name / "config.yaml").read_text().replace(name, "")
        found[name] = [(line["step"], line["loss"]) for line in lines], config
    assert b"1.25" in done.stdout
    inputs = "decimal comma, time zone, ascii, no terminal, no standard error: metrics or config that differ"
    numeric_row("K27", inputs, found["odd"] != found["plain"])


@pytest.mark.parametrize("text", ["", "3\n", "[]\n"])
def test_a_damaged_config_of_a_begun_run_is_named(tmp_path, text):
    with TrainingRun(tmp_path, {"rate": 0.1}, 1, {}) as run:
        list(run.steps())
    assert begun_config(tmp_path) == {"rate": 0.1}
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(UserError, match=r"config\.yaml"):
        begun_config(tmp_path)
    assert begun_config(tmp_path, overwrite=True) is None
