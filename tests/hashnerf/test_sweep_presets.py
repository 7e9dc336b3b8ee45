"""Front, presets and knobs that buy nothing, on results worked by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.pareto import dominated
from hashnerf.sweep_presets import chosen_presets, front_of, measured, worse_for_more
from hashnerf.sweep_runs import Result
from tests.hashnerf.sweeps import small_sweep

# base, steps 1, steps 4, width 3, steps 1 with width 3, steps 4 with width 3: (cost, quality)
FIGURES = [(4.0, 22.0), (2.0, 20.0), (8.0, 23.0), (6.0, 21.5), (3.0, 19.0), (9.0, 23.05)]


def results_of(sweep, figures=FIGURES):
    rows = sweep.rows()
    return [Result(row, {"seconds": cost, "quality": quality}) for row, (cost, quality) in zip(rows, figures)]


def test_the_front_is_what_none_beats_cheapest_first(tmp_path):
    sweep = small_sweep(tmp_path)
    assert [one.row.name for one in front_of(sweep, results_of(sweep))] == ["steps_1", "base", "steps_4", "combined_2"]


def test_presets_are_the_cheapest_that_are_close_enough(tmp_path):
    sweep = small_sweep(tmp_path)
    chosen = {name: one.row.name for name, one in chosen_presets(sweep, results_of(sweep)).items()}
    # best 23.05: within 2.5 dB no 20.0, but 22.0; within 1.5 dB 22.0, too; the best itself
    assert chosen == {"fast": "base", "balanced": "base", "accurate": "combined_2"}
    wider = small_sweep(tmp_path, presets={"fast": 3.05})
    assert chosen_presets(wider, results_of(wider))["fast"].row.name == "steps_1"


def test_less_may_be_better(tmp_path):
    sweep = small_sweep(tmp_path, accuracy="mean", presets={"fast": 1.0, "accurate": 0.0})
    rows = [Result(row, {"seconds": cost, "mean": value}) for row, (cost, value) in zip(sweep.rows(), FIGURES)]
    assert [one.row.name for one in front_of(sweep, rows)] == ["steps_1", "combined_1"]
    chosen = {name: one.row.name for name, one in chosen_presets(sweep, rows).items()}
    assert chosen == {"fast": "steps_1", "accurate": "combined_1"}


def test_failed_rows_are_left_out(tmp_path):
    sweep = small_sweep(tmp_path)
    failed = [Result(row, {}, "it broke") for row in sweep.rows()]
    assert measured(sweep, failed) == [] and front_of(sweep, failed) == [] and chosen_presets(sweep, failed) == {}
    some = [*failed[:2], *results_of(sweep)[2:]]
    assert [one.row.name for one in front_of(sweep, some)] == ["combined_1", "width_3", "steps_4", "combined_2"]


def test_a_knob_that_costs_more_and_is_worse_is_found(tmp_path):
    sweep = small_sweep(tmp_path)
    pairs = worse_for_more(sweep, results_of(sweep), "width")
    assert [(cheaper.row.name, dearer.row.name) for cheaper, dearer in pairs] == [("base", "width_3")]
    assert worse_for_more(sweep, results_of(sweep), "steps") == []
    tolerant = small_sweep(tmp_path, noise=0.5)
    assert worse_for_more(tolerant, results_of(tolerant), "width") == []


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    return small_sweep(tmp_path_factory.mktemp("sweep"))


@given(st.lists(st.tuples(st.integers(1, 6), st.integers(0, 6)), min_size=1, max_size=6))
def test_no_preset_is_dominated_by_any_row(sweep, figures):
    rows = results_of(sweep, [(float(cost), float(quality)) for cost, quality in figures])
    points = np.array([[one.figures["seconds"], -one.figures["quality"]] for one in rows])
    worse = {one.row.name for one, beaten in zip(rows, dominated(points)) if beaten}
    chosen = chosen_presets(sweep, rows)
    assert set(chosen) == {"fast", "balanced", "accurate"}
    assert not worse & {one.row.name for one in chosen.values()}
    best = max(one.figures["quality"] for one in rows)
    assert chosen["accurate"].figures["quality"] == best
    assert all(one.figures["quality"] >= best - sweep.presets[name] for name, one in chosen.items())
