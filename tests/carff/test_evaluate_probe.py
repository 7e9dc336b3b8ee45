"""Which views the probe is judged on, and how its answers are counted."""

from dataclasses import replace

import numpy as np
import torch

from carff.evaluate_probe import accuracy_by_evidence, class_name, confusion, evaluate_probe, evidence_px


def test_a_run_that_knows_everything_is_right_on_every_settled_view(tiny_evaluation):
    part = evaluate_probe(tiny_evaluation)
    probe = part.results["probe"]
    # Cameras 1, 2, 3 settle all four states; camera 0 none.
    assert (probe["accuracy"], probe["views"], probe["test_views"], probe["unknown"]) == (1.0, 12, 4, 0.0)
    assert probe["confusion"]["counts"] == (3 * np.eye(4, 5, dtype=int)).tolist()
    assert "probe_confusion" in part.figures


def test_unknown_and_wrong_answers_are_both_wrong(tiny_evaluation, monkeypatch):
    model = tiny_evaluation.model
    monkeypatch.setattr(type(model), "probe_latents", lambda self, latents: torch.full((len(latents),), -1))
    probe = evaluate_probe(tiny_evaluation).results["probe"]
    assert (probe["accuracy"], probe["unknown"]) == (0.0, 1.0)
    monkeypatch.setattr(type(model), "probe_latents", lambda self, latents: torch.zeros(len(latents)).long())
    probe = evaluate_probe(tiny_evaluation).results["probe"]
    assert (probe["accuracy"], probe["unknown"]) == (0.25, 0.0)


def test_states_with_the_same_boxes_count_as_one_answer(tiny_evaluation):
    occupied = tiny_evaluation.model.probe.candidates.occupied
    occupied[2] = occupied[0]
    # Both branches' pictures of step 0 at camera 0 now ask for the same boxes: two more views are settled.
    assert evaluate_probe(tiny_evaluation).results["probe"]["views"] == 14
    assert class_name(tiny_evaluation, tiny_evaluation.same_boxes == 0) == "absent t0 = present t0"


def test_without_settled_pictures_there_is_a_reason(tiny_evaluation):
    hidden = tiny_evaluation.views.select(tiny_evaluation.views.camera == 0)
    part = evaluate_probe(replace(tiny_evaluation, views=hidden))
    assert "probe" in part.not_run and not part.results


def test_evidence_is_the_smallest_difference_that_matters(tiny_evaluation):
    evidence = evidence_px(tiny_evaluation, tiny_evaluation.same_boxes)
    # Camera 0 shows absent and present alike. Elsewhere the truck fills 12 x 12 = 144 pixels, and the ego's own move
    # from one step to the next changes 2 x 4 x 8 = 64; where the truck stands it moves too, which changes more.
    assert evidence[:, 0].tolist() == [0, 0, 0, 0]
    assert (evidence[:2, 1:] == 64).all() and (evidence[2:, 1:] == 144).all()
    assert (evidence_px(tiny_evaluation, torch.zeros(4).long()) == 32 * 32).all(), "one label: nothing to tell apart"
    branch = evidence_px(tiny_evaluation, torch.tensor([0, 0, 1, 1]))
    assert (branch[:, 1:] == 144).all(), "only the truck tells the branches apart"


def test_accuracy_by_evidence_by_hand():
    rows = accuracy_by_evidence(np.array([True, False, True, True]), np.array([9, 0, 10, 5000]))
    assert [(row["low"], row["high"], row["views"], row["accuracy"]) for row in rows] == [
        (0, 10, 2, 0.5),
        (10, 30, 1, 1.0),
        (30, 100, 0, None),
        (100, None, 1, 1.0),
    ]


def test_confusion_by_hand():
    distinct = torch.tensor([0, 2, 5])
    counts = confusion(torch.tensor([0, 0, 2, 5, 5]), torch.tensor([0, 2, 2, -1, 0]), distinct)
    assert counts.tolist() == [[1, 1, 0, 0], [0, 1, 0, 0], [1, 0, 0, 1]]
