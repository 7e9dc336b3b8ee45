"""Configs from YAML layers and arguments: what is accepted, and the one sentence for everything that is not."""

import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hashnerf.command_line import (
    flat_config,
    load_config,
    parse_config,
    plain_config,
    run_main,
    save_config,
    set_threads,
    usable_cores,
)
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Optimiser:
    """How weights move."""

    steps: int = 100
    """Number of optimiser steps."""
    rate: float = 0.002
    """Learning rate."""
    betas: tuple[float, float] = (0.9, 0.99)
    """Decay rates of Adam's moments."""
    kind: Literal["adam", "sgd"] = "adam"
    """Which optimiser."""

    def __post_init__(self):
        if self.steps < 1:
            raise UserError(f"train.steps = {self.steps} must be at least 1.")


@dataclass(frozen=True)
class Config:
    """A script's settings."""

    data: Path
    """Folder of the data set."""
    name: str = "first"
    """Name of the run."""
    mirror: bool = False
    """Whether to mirror."""
    sizes: tuple[int, ...] = (4, 8)
    """Grid sizes."""
    limit: int | None = None
    """Largest number of images, or nothing for all."""
    weights: dict[str, float] = field(default_factory=dict)
    """Weight of each loss."""
    train: Optimiser = field(default_factory=Optimiser)
    """Training settings."""


def write(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def refused(*argv: str) -> str:
    with pytest.raises(UserError) as caught:
        parse_config(Config, list(argv))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_layers_then_arguments_win(tmp_path):
    first = write(tmp_path / "a.yaml", "data: here\nname: one\ntrain:\n  steps: 5\n  rate: 0.5\n")
    second = write(tmp_path / "b.yaml", "name: two\ntrain:\n  steps: 6\n")
    config = parse_config(Config, ["--config", first, f"--config={second}", "--train.steps", "7", "--mirror", "true"])
    assert config == Config(Path("here"), "two", mirror=True, train=Optimiser(steps=7, rate=0.5))
    # An argument before --config still wins over the file.
    assert parse_config(Config, ["--train.steps", "7", "--config", first]).train.steps == 7
    assert parse_config(Config, ["--config", second, "--config", first]).name == "one"


def test_defaults_alone():
    assert parse_config(Optimiser, []) == Optimiser()


def test_k33_numbers_that_yaml_1_1_reads_as_text(tmp_path, numeric_row):
    text = "data: d\ntrain:\n  rate: 1e-3\n  betas: [9e-1, 1]\n"
    assert isinstance(yaml.safe_load(text)["train"]["rate"], str)  # the trap: PyYAML does not see a number here
    config = load_config(Config, Path(write(tmp_path / "a.yaml", text)))
    numeric_row("K33", "1e-3 for a number: error", abs(config.train.rate - 0.001))
    assert config.train.betas == (0.9, 1.0)


BAD_YAML = [
    ("train:\n  stepz: 6\n", ["a.yaml", "'train.stepz'", "did you mean 'train.steps'?"]),
    ("trian:\n  steps: 6\n", ["a.yaml", "'trian'", "did you mean 'train'?"]),
    ("zzz: 6\n", ["a.yaml", "'zzz'", "known: data, limit, mirror, name, sizes, train, weights."]),
    ("train:\n  steps: six\n", ["a.yaml", "train.steps = 'six'", "expected int"]),
    ("train:\n  steps: 6.5\n", ["train.steps = 6.5", "expected int"]),
    ("train:\n  steps: true\n", ["train.steps = True", "expected int"]),
    ("train:\n  steps:\n", ["train.steps is empty", "expected int"]),
    ("train:\n  rate: fast\n", ["train.rate = 'fast'", "expected float"]),
    ("train:\n  rate: .nan\n", ["a.yaml: train.rate = nan is not a number"]),
    ("train:\n  betas: [0.9, .nan]\n", ["train.betas"]),
    ("train:\n  betas: [0.9]\n", ["train.betas = [0.9]", "tuple[float, float]"]),
    ("train:\n  kind: adan\n", ["train.kind = 'adan'", "one of 'adam', 'sgd'"]),
    ("train: 5\n", ["train = 5", "group"]),
    ("train: [1]\n", ["train = [1]", "group"]),
    ("name: 5\n", ["name = 5", "expected str"]),
    ("name: no\n", ["name = False", "expected str"]),
    ("limit: many\n", ["limit = 'many'", "int or nothing"]),
    ("weights: {rgb: x}\n", ["weights", "dict[str, float]"]),
    ("name: a\nname: b\n", ["'name' is given twice in line 2"]),
    ("train:\n  steps: 1\n  steps: 2\n", ["'steps' is given twice in line 3"]),
    ("- 1\n", ["list"]),
    ("name: [\n", ["line"]),
    ("name: !!python/object/apply:os.system [ls]\n", ["constructor"]),
    ("? [a, b]\n: 1\n", ["a key must be a word"]),
    ("a: &x [1]\nb: *x\n", ["aliases", "line 2"]),
    ("name: \x00\n", ["a.yaml"]),
    ("[" * 100_000, ["nested too deeply"]),
    ("name: " + "x" * 1_000_001, ["larger than 1000000 bytes"]),
]


def test_k33_bad_files_get_one_sentence(tmp_path, numeric_row):
    wrong = []
    for text, expected in BAD_YAML:
        try:
            parse_config(Config, ["--config", write(tmp_path / "a.yaml", text), "--data", "d"])
            wrong.append(text[:60])
        except UserError as error:
            said = str(error)
            wrong += [] if "\n" not in said and all(part in said for part in expected) else [(text[:60], said)]
    print(wrong)
    numeric_row(
        "K33", f"{len(BAD_YAML)} files: tags, types, unknown and double keys, depth: accepted, or not named", len(wrong)
    )


def test_k33_a_tag_that_runs_a_command_does_not(tmp_path, numeric_row):
    proof = tmp_path / "proof"
    refused("--config", write(tmp_path / "a.yaml", f"name: !!python/object/apply:os.system ['touch {proof}']"))
    numeric_row("K33", "a tag that runs a command: files that it made", proof.exists())


def test_unreadable_files_get_one_sentence(tmp_path):
    assert "no such config file" in refused("--config", str(tmp_path / "missing.yaml"))
    assert "no such config file" in refused("--config", str(tmp_path))
    assert "needs the path" in refused("--config")
    (tmp_path / "latin.yaml").write_bytes(b"name: caf\xe9\n")
    assert "latin.yaml" in refused("--config", str(tmp_path / "latin.yaml"))


def test_k33_an_alias_bomb_is_refused_before_it_is_walked(tmp_path, numeric_row):
    lines = ["a0: &a0 [x]"] + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
    told = "aliases" in refused("--config", write(tmp_path / "a.yaml", "\n".join(lines)))
    numeric_row("K33", "ten levels of nine aliases: not refused for its aliases", not told)


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["--train.stepz", "6"], ["--train.stepz", "did you mean 'train.steps'?"]),
        (["--train.stepz=6"], ["did you mean 'train.steps'?"]),
        (["--train.steps", "six"], ["--train.steps = six", "expected int"]),
        (["--train.rate", "nan"], ["--train.rate = nan"]),
        (["--train.rate", ".nan"], ["--train.rate = nan is not a number"]),
        (["--train.kind", "adan"], ["--train.kind = adan", "'adam', 'sgd'"]),
        (["--limit", "many"], ["--limit = many", "int or nothing"]),
        (["--train.steps"], ["--train.steps", "expected one argument"]),
        (["stray"], ["stray"]),
        (["--train", "{steps: 5}"], ["unknown argument --train"]),
        (["--train=other.yaml"], ["unknown argument --train"]),
        (["--train.steps", "-3"], ["train.steps = -3 must be at least 1"]),
    ],
)
def test_bad_arguments_get_one_sentence(argv, expected):
    message = refused("--data", "d", *argv)
    assert all(part in message for part in expected), message


def test_a_missing_required_value_is_named():
    assert "needs a value for data" in refused()


def test_check_of_the_class_runs_for_files_too(tmp_path):
    assert "must be at least 1" in refused("--data", "d", "--config", write(tmp_path / "a.yaml", "train: {steps: 0}"))


@settings(max_examples=40)
@given(
    st.builds(
        Config,
        data=st.sampled_from([Path("a"), Path("a b/c"), Path("x/ä")]),
        name=st.text(st.characters(codec="ascii", exclude_categories=["Cc"]))
        | st.sampled_from(["no", "1e-3", "~", "5"]),
        sizes=st.lists(st.integers(), max_size=3).map(tuple),
        limit=st.none() | st.integers(),
        weights=st.dictionaries(st.sampled_from(["rgb", "kl"]), st.floats(allow_nan=False, allow_infinity=False)),
        train=st.builds(Optimiser, steps=st.integers(1), rate=st.floats(allow_nan=False)),
    )
)
def test_every_config_survives_the_round_trip(tmp_path_factory, config):
    path = tmp_path_factory.mktemp("config") / "config.yaml"
    save_config(config, path)
    assert load_config(Config, path) == config
    assert list(path.parent.iterdir()) == [path]  # no temporary is left


def test_plain_and_flat_config():
    plain = plain_config(Config(Path("d"), weights={"rgb": 1.0}))
    assert plain["sizes"] == [4, 8]
    assert plain["data"] == "d"
    flat = flat_config(plain)
    assert flat["train.rate"] == 0.002
    assert flat["weights.rgb"] == 1.0


def test_help_shows_every_field_with_its_sentence_and_default(capsys):
    with pytest.raises(SystemExit) as caught:
        parse_config(Config, ["--help"], description="Does a thing.")
    assert caught.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    for part in (
        "Does a thing.",
        "--train.steps",
        "Number of optimiser steps.",
        "default: 100",
        "Folder of the data set.",
    ):
        assert part in text
    assert "--train " not in text


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        ("return 0", 0, ""),
        ("return None", 0, ""),
        ("return 3", 3, ""),
        ("raise UserError('a.png: broken; replace it.')", 2, "a.png: broken; replace it."),
        ("raise DataError('set', ['one', 'two'])", 2, "set: 2 problems\n  one\n  two"),
        ("raise KeyboardInterrupt", 130, "Interrupted."),
        ("raise OSError(28, 'No space left on device', 'x.png')", 1, "The disk is full"),
        ("raise NotADirectoryError(20, 'Not a directory', 'a/b')", 2, "a/b: Not a directory; give another path"),
    ],
)
def test_run_main_statuses_and_sentences(capsys, body, status, words):
    scope = {"UserError": UserError}
    exec(f"from hashnerf.errors import DataError\ndef main():\n    {body}", scope)
    with pytest.raises(SystemExit) as caught:
        run_main(scope["main"])
    assert caught.value.code == status
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("MemoryError", "Out of memory"),
        ("RuntimeError('CUDA out of memory. Tried to allocate 2 GiB')", "Out of memory: CUDA"),
        ("torch.empty(1 << 60)", "Out of memory"),
    ],
)
def test_k24_out_of_memory_ends_in_a_sentence(capsys, error, words, numeric_row):
    scope = {"torch": torch}
    exec(f"def main():\n    raise {error}", scope)
    with pytest.raises(SystemExit) as caught:
        run_main(scope["main"])
    said = capsys.readouterr().err
    wrong = (caught.value.code != 1) + (words not in said) + ("use smaller batches" not in said) + ("Traceback" in said)
    numeric_row("K24", f"{error.split('(')[0]}: no exit 1, or not in a sentence", wrong)


def test_run_main_keeps_the_traceback_of_a_bug():
    def main():
        raise RuntimeError("shapes differ")

    with pytest.raises(RuntimeError, match="shapes differ"):
        run_main(main)


def script(body: str) -> list[str]:
    code = f"from hashnerf.command_line import run_main\ndef main():\n    {body}\nrun_main(main)"
    return [sys.executable, "-c", code]


def run_script(body: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run(script(body), cwd=ROOT, stderr=subprocess.PIPE, timeout=60, **options)


def test_a_reader_that_leaves_early_is_no_error():
    writer = subprocess.Popen(
        script("print('x\\n' * 100_000)"), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert writer.stdout.readline() == b"x\n"
    writer.stdout.close()
    assert writer.wait(timeout=60) == 141  # as a shell reports SIGPIPE
    assert writer.stderr.read() == b""
    writer.stderr.close()


def test_k27_a_terminal_that_is_not_utf8(tmp_path, numeric_row):
    with open(tmp_path / "out", "wb") as out:
        done = run_script("print('sigma \\u03c3')", stdout=out, env={"PYTHONIOENCODING": "ascii", "PATH": ""})
    assert done.returncode == 0, done.stderr
    lost = (tmp_path / "out").read_bytes() != b"sigma \\u03c3\n"
    numeric_row("K27", "a Greek letter on a terminal of ASCII: lost", lost)


def test_k27_closed_standard_streams_are_no_error(numeric_row):
    """As a service manager or `>&- 2>&-` leaves them: Python then has no stream at all."""
    code = script("print('x'); sys.stderr.write('y')")
    code[-1] = "import sys\n" + code[-1]
    done = subprocess.run(["sh", "-c", 'exec "$@" >&- 2>&-', "sh", *code], cwd=ROOT, timeout=60)
    numeric_row("K27", "no standard output and no standard error: exit status", done.returncode)


def test_a_full_disk_behind_standard_output():
    with open("/dev/full", "wb") as full:
        done = run_script("print('x')", stdout=full)
    assert done.returncode != 0
    assert b"The disk is full" in done.stderr
    assert b"Traceback" not in done.stderr


def test_threads():
    before = torch.get_num_threads()
    try:
        set_threads(1)
        assert torch.get_num_threads() == 1
        set_threads(0)
        assert torch.get_num_threads() >= 1
    finally:
        torch.set_num_threads(before)
    with pytest.raises(UserError, match="threads = -1"):
        set_threads(-1)


def test_there_is_a_core():
    assert 1 <= usable_cores() <= (os.cpu_count() or 1)
