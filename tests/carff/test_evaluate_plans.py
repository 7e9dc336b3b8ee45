"""Which pictures are planned from, and whether decisions are counted rightly."""

from dataclasses import replace

import pytest
import torch

from carff.evaluate_plans import (
    decision_milliseconds,
    evaluate_plans,
    spread,
    trial_decisions,
    trial_pictures,
)


def places(evaluation, kind) -> set[tuple[int, int]]:
    views = evaluation.views
    return set(zip(views.state[kind].tolist(), views.camera[kind].tolist()))


def with_hazard(evaluation, *flags: bool):
    return replace(evaluation, table=replace(evaluation.table, hazard=torch.tensor(flags)))


def test_pictures_are_spread_over_cameras_test_cameras_first(tiny_evaluation):
    views = tiny_evaluation.views
    everything = torch.ones(16, dtype=torch.bool)
    rows = spread(views, everything, 14, torch.Generator().manual_seed(0))
    cameras = views.camera[rows].tolist()
    assert cameras[:4] == [2, 2, 2, 2], "all pictures of the test camera come first"
    assert sorted(cameras[4:7]) == [0, 1, 3] and sorted(cameras[7:10]) == [0, 1, 3], "then each camera once, and again"
    assert len(views.picture[rows].unique()) == 14, "no picture twice"
    assert len(spread(views, everything, 100, torch.Generator().manual_seed(0))) == 14


def test_other_cameras_fill_up_only_where_the_ego_has_too_few(tiny_evaluation):
    config = tiny_evaluation.config
    many = replace(tiny_evaluation, config=replace(config, evaluation=replace(config.evaluation, images=3)))
    pictures = trial_pictures(many)
    # hazard: only camera 0 hides it; clear: ego cameras 1 and 2, and the bird's-eye camera 3 fills up
    assert pictures.hazard.tolist() == [True, False, False, False]
    assert tiny_evaluation.views.camera[pictures.view].tolist()[:2] == [0, 2]
    assert tiny_evaluation.views.camera[pictures.view].tolist()[3] == 3
    assert pictures.notes == (
        "The data has only 1 different hazard pictures.",
        "The ego's cameras give 2 different clear pictures; other cameras add 1.",
    )
    assert trial_pictures(tiny_evaluation).view.tolist() == pictures.view.tolist()[:3]


def test_where_nothing_is_hidden_shown_hazards_are_tried(tiny_evaluation):
    views = tiny_evaluation.views.select(tiny_evaluation.views.camera != 0)
    pictures = trial_pictures(replace(tiny_evaluation, views=views))
    assert set(views.state[pictures.view[pictures.hazard]].tolist()) == {2}
    assert pictures.notes[0].startswith("No picture hides a hazard")


def test_decisions_of_a_run_that_knows_everything(tiny_evaluation):
    pictures = trial_pictures(tiny_evaluation)
    decisions = trial_decisions(tiny_evaluation, pictures)
    assert set(decisions) == {(rule, n) for rule in ("risk", "paper") for n in (2, 10, 35)}
    hidden, clear = decisions["paper", 35][0], decisions["paper", 35][1:]
    # A hidden truck shows in half of the futures: 35 clear ones in a row have probability 2^-35.
    assert not hidden.any() and clear.all() and hidden.shape == (4,)
    assert not decisions["risk", 35][0].any() and decisions["risk", 10][1:].all()


def test_two_samples_show_both_of_two_equal_futures(tiny_evaluation):
    config = tiny_evaluation.config
    long = replace(tiny_evaluation, config=replace(config, evaluation=replace(config.evaluation, trials=200)))
    decisions = trial_decisions(long, trial_pictures(long))
    go = decisions["paper", 2][0]
    # Independent draws are both clear in 50 of 200 trials, systematic ones only as the weights are not quite 1/2.
    assert go.sum() < 25
    assert not decisions["risk", 10][0].any() and not decisions["paper", 10][0].any()


def test_the_part(tiny_evaluation):
    part = evaluate_plans(tiny_evaluation)
    assert part.results["plan"]["paper"]["n35"]["hazard_success"] == 1.0
    assert part.results["plan"]["risk"]["n10"]["clear_success"] == 1.0
    assert part.results["plan"]["always_go"]["hazard_success"] == 0.0
    assert part.results["decision_ms_n10"] > 0 and "planning" in part.figures and not part.not_run
    images = part.results["plan_images"]
    assert (images["hazard"], images["clear"], images["clear_test_cameras"]) == (1, 2, 1)
    assert images["notes"][0].startswith("1 hazard pictures (0 of test cameras) and 2 clear pictures (1 of test")


@pytest.mark.parametrize(
    ("flags", "missing"), [((False,) * 4, "hazard"), ((True,) * 4, "clear")], ids=["nothing unsafe", "nothing safe"]
)
def test_a_missing_kind_has_a_reason_for_each_of_its_figures(tiny_evaluation, flags, missing):
    part = evaluate_plans(with_hazard(tiny_evaluation, *flags))
    keys = {f"plan.{rule}.n{n}.{missing}_success" for rule in ("risk", "paper") for n in (2, 10, 35)}
    assert set(part.not_run) == keys | {"plan.risk.n35_change", "plan.paper.n35_change"}


def test_without_flags_nothing_is_planned(tiny_evaluation):
    part = evaluate_plans(replace(tiny_evaluation, table=replace(tiny_evaluation.table, hazard=None)))
    assert set(part.not_run) == {"plan", "decision_ms_n10"} and not part.results


def test_the_time_of_a_decision_is_the_median_after_warming_up(tiny_evaluation, monkeypatch):
    # Warm-up calls take 100 s each, the others 1, 2, ... 24 ms: median 12.5 ms.
    clock, spans = [0.0], iter([100.0] * 3 + [i / 1000 for i in range(1, 25)])
    monkeypatch.setattr("carff.evaluate_plans.time.perf_counter", lambda: clock[0])

    def slow(*arguments) -> list:
        clock[0] += next(spans)
        return []

    monkeypatch.setattr("carff.evaluate_plans.decide_from_pictures", slow)
    generator = torch.Generator()
    images = tiny_evaluation.data.images
    assert decision_milliseconds(tiny_evaluation.model, images[:5], 10, generator) == pytest.approx(12.5, abs=1e-6)


def test_every_picture_is_listed_with_its_evidence_and_its_own_success(tiny_evaluation):
    results = evaluate_plans(tiny_evaluation).results
    rows = results["plan_images"]["pictures"]
    hidden = next(row for row in rows if row["camera"] == 0)
    # Camera 0 shows state 2 (present, t0) like state 0 (absent, t0); the others tell the truck by 12 x 12 pixels.
    assert (hidden["kind"], hidden["state"], hidden["evidence_px"]) == ("hazard", [1, 0], 0)
    clear = [row for row in rows if row["kind"] == "clear"]
    assert clear and all(row["state"] == [0, 0] and row["evidence_px"] == 144 for row in clear)
    for kind in ("hazard", "clear"):
        own = [row["success"] for row in rows if row["kind"] == kind]
        assert sum(own) / len(own) == pytest.approx(results["plan"]["risk"]["n10"][f"{kind}_success"])
