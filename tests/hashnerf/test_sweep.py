"""What a sweep file may say, which rows it makes, and what every stage is told."""

from pathlib import Path

import pytest

from hashnerf.errors import UserError
from hashnerf.sweep import BASE, COMBINED, load_sweep
from tests.hashnerf.sweeps import FIGURE, PLAN, small_sweep, write_sweep

ROOT = Path(__file__).resolve().parents[2]


def test_rows_are_the_base_each_value_and_the_combinations(tmp_path):
    rows = small_sweep(tmp_path).rows()
    assert [(row.name, row.knob) for row in rows] == [
        ("base", BASE), ("steps_1", "steps"), ("steps_4", "steps"), ("width_3", "width"),
        ("combined_1", COMBINED), ("combined_2", COMBINED),
    ]  # fmt: skip
    assert [tuple(row.settings.values()) for row in rows] == [
        ((2,), (1,)), ((1,), (1,)), ((4,), (1,)), ((2,), (3,)), ((1,), (3,)), ((4,), (3,))
    ]  # fmt: skip


def test_no_setting_comes_twice_and_a_sweep_needs_no_combinations(tmp_path):
    twice = small_sweep(tmp_path, pareto={"steps": [2, 4], "width": [1]})
    assert [row.name for row in twice.rows()] == ["base", "steps_1", "steps_4", "width_3"]
    assert len(small_sweep(tmp_path, pareto=None).rows()) == 4


def test_a_stage_is_told_layers_place_options_and_the_knobs_that_it_knows(tmp_path):
    knobs = {
        "size": {"keys": ["a.w", "a.h"], "values": [[4, 3], [8, 6]]},
        "lines": {"key": "lines", "values": [[[6, 4]], [[2, 2]]]},
        "futures": {"key": "futures", "values": [10], "stage": "measure"},
    }
    sweep = small_sweep(
        tmp_path, knobs=knobs, pareto=None, base=["a.yaml", "b.yaml"], options={"threads": 1, "word": "x", "flag": True}
    )
    commands = sweep.commands(sweep.rows()[1], Path("runs/small"), Path("scripts"))
    place = ["--config", "a.yaml", "--config", "b.yaml", "--runs", "runs/small", "--name", "size_8_x_6"]
    told = ["--threads", "1", "--word", "x", "--flag", "true", "--a.w", "8", "--a.h", "6", "--lines", "[6, 4]"]
    assert commands["train"] == ["scripts/fake.py", *place, *told, "--part", "train"]
    assert commands["measure"] == ["scripts/fake.py", *place, *told, "--futures", "10", "--part", "measure"]
    assert sweep.knobs["lines"].label(sweep.rows()[2].settings["lines"]) == "2 x 2"


def test_a_shared_run_has_its_own_options_and_rows_have_them_too(tmp_path):
    shared = {"name": "first", "options": {"width": 5}, "stages": {"begin": "fake.py --part begin"}}
    sweep = small_sweep(
        tmp_path, shared=shared, options={"threads": 1}, knobs={"steps": PLAN["knobs"]["steps"]}, pareto=None
    )
    place = ["--runs", "runs/shared", "--name", "first"]
    assert sweep.shared_commands(Path("runs/shared"), Path("s")) == {
        "begin": ["s/fake.py", *place, "--threads", "1", "--width", "5", "--part", "begin"]
    }
    told = sweep.commands(sweep.rows()[0], Path("runs"), Path("s"))["train"]
    assert told[5:] == ["--threads", "1", "--width", "5", "--steps", "2", "--part", "train"]
    assert small_sweep(tmp_path).shared_commands(Path("runs"), Path("s")) == {}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"title": None}, "small.yaml: lacks title"),
        ({"knobz": {}}, "unknown key 'knobz'; did you mean 'knobs'"),
        ({"cost": "seconts"}, "cost: 'seconts' is not there; did you mean 'seconds'"),
        ({"timed": ["trains"]}, "timed: 'trains' is not there; did you mean 'train'"),
        ({"pareto": {"step": [1]}}, "pareto: 'step' is not there; did you mean 'steps'"),
        ({"figures": {"seconds": FIGURE}}, "figures.seconds: lacks key"),
        ({"figures": {"seconds": FIGURE | {"key": "s", "better": "high"}}}, "better is 'high'; give more or less"),
        ({"knobs": {"steps": {"values": [1]}}}, "knobs.steps: needs a key"),
        ({"knobs": {"steps": {"key": "steps", "values": []}}}, "at least one value"),
        ({"knobs": {"size": {"keys": ["w", "h"], "values": [[1]]}}}, r"value \[1\] is not one for each of w, h"),
        ({"knobs": {"steps": {"key": "s", "values": [1], "stage": "mesure"}}}, "did you mean 'measure'"),
        ({"knobs": {"steps": 3}}, "knobs.steps: is 3; give `key: value` lines"),
        ({"knobs": {"steps": {"key": "s", "values": list(range(300))}}, "pareto": None}, "makes 300 rows; give fewer"),
    ],
)
def test_what_does_not_fit_is_one_sentence_that_names_it(tmp_path, changes, sentence):
    with pytest.raises(UserError, match=sentence):
        small_sweep(tmp_path, **changes)


def test_the_sweeps_of_this_repository_are_whole():
    files = sorted((ROOT / "configs" / "tradeoff").glob("*.yaml"))
    assert len(files) >= 5
    for path in files:
        sweep = load_sweep(path)
        for command in (*sweep.stages.values(), *(sweep.shared.stages.values() if sweep.shared else ())):
            assert (ROOT / "scripts" / command.split()[0]).is_file(), path
        assert all((ROOT / layer).is_file() for layer in sweep.base), path
        names = [row.name for row in sweep.rows()]
        assert len(set(names)) == len(names), path
        assert "fast" in sweep.presets and "accurate" in sweep.presets


def test_a_file_that_is_missing_is_a_sentence(tmp_path):
    with pytest.raises(UserError, match="no such config file"):
        load_sweep(tmp_path / "none.yaml")
    assert write_sweep(tmp_path).is_file()


def test_a_combination_gives_a_value_for_every_key(tmp_path):
    knobs = {"size": {"keys": ["a.w", "a.h"], "values": [[4, 3], [8, 6]]}}
    with pytest.raises(UserError, match=r"pareto.size: value \[8\] is not one for each of a.w, a.h"):
        small_sweep(tmp_path, knobs=knobs, pareto={"size": [[8]]})


def test_rows_do_not_share_a_folder(tmp_path):
    with pytest.raises(UserError, match="two rows would share the folder steps_1"):
        small_sweep(tmp_path, knobs={"steps": {"key": "steps", "values": [2, 1, -1]}}, pareto=None)
