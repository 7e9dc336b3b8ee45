"""Probing: geometry of the candidate lines, thickness by hand, calibration, absent and unknown as answers."""

import math

import pytest
import torch

from carff.probe import UNKNOWN, ProbeConfig, box_points, box_thickness, build_candidates, calibrate, line_scores
from carff.states import ActorBox
from hashnerf.errors import UserError

CONFIG = ProbeConfig(columns=(3, 2), levels=4, margin=0.1)
NEAR = ActorBox("truck", (0.0, 0.0, 1.0), (4.0, 2.0, 2.0), 0.0)
FAR = ActorBox("truck", (20.0, 0.0, 1.0), (4.0, 2.0, 2.0), math.pi / 2)
STATES = [[NEAR], [FAR], []]


def density_of(states):
    """A density of `value` inside the box that each latent names (latent = state number); 0 elsewhere."""

    def density_fn(points, latents):
        rows = []
        for latent in latents[:, 0].int().tolist():
            inside = torch.zeros(len(points))
            for box in states[latent]:
                inside += ((points - torch.tensor(box.center)).abs().amax(dim=1) < 2.5).float()
            rows.append(inside * 3.0)
        return torch.stack(rows)

    return density_fn


def test_points_lie_inside_the_turned_box():
    # Length 4 along y after a quarter turn: 80 % of 4 x 2 x 2, centres of 3 x 2 cells.
    points = box_points(FAR, CONFIG).reshape(-1, 3) - torch.tensor([20.0, 0.0, 1.0])
    assert torch.allclose(points.abs().amax(dim=0), torch.tensor([0.4, 1.6 / 1.5 * 1.0, 0.6]), atol=1e-5)


def test_scores_by_hand():
    # A line of 4 points 0.4 m apart at density 3 has thickness 4.8: 1 - exp(-4.8) = 0.99177, 1 - exp(-1.2) = 0.69881.
    candidates = build_candidates(STATES, CONFIG)
    thickness = box_thickness(candidates, torch.tensor([[0.0], [2.0]]), density_of(STATES))
    assert thickness.shape == (2, 2, 6)
    scores = line_scores(thickness, torch.tensor([1.0, 1.0]))
    assert torch.allclose(scores, torch.tensor([[0.99177, 0.0], [0.0, 0.0]]), atol=1e-5)
    assert line_scores(thickness, torch.tensor([0.25, 1.0]))[0, 0] == pytest.approx(0.69881, abs=1e-5)


@pytest.mark.parametrize("density, score", [(0.0, 0.0), (1e3, 1.0), (1e30, 1.0), (math.inf, 1.0)])
def test_scores_are_bounded(density, score):
    candidates = build_candidates(STATES, CONFIG)
    thickness = box_thickness(
        candidates, torch.zeros(1, 1), lambda points, latents: torch.full((1, len(points)), density)
    )
    assert torch.equal(line_scores(thickness, torch.ones(2)), torch.full((1, 2), score))


def test_an_empty_box_full_of_fog_is_still_told_from_an_occupied_one():
    # thickness 6 without the actor and 30 with it: both let less than 0.3 % of the light through
    candidates = build_candidates(STATES, CONFIG)
    latents = torch.tensor([[0.0], [1.0], [2.0]]).repeat(10, 1)
    thickness = box_thickness(candidates, latents, lambda points, rows: 3.75 + 5 * density_of(STATES)(points, rows))
    probe = calibrate(candidates, thickness, latents[:, 0].long(), 0.6)
    assert probe.gain[0] == pytest.approx(1 / (6 * 30) ** 0.5, rel=1e-4)
    assert torch.equal(probe.classify(line_scores(thickness, probe.gain)), latents[:, 0].long())


def test_a_faint_ghost_in_clean_air_is_no_actor():
    # empty boxes of thickness 0.001 and occupied ones of 5: a tenth is nearer to 5 by its logarithm, but nine tenths
    # of the light pass
    candidates = build_candidates(STATES, CONFIG)
    state = torch.tensor([0, 1, 2]).repeat(10)
    thickness = torch.where(candidates.occupied[state], 5.0, 0.001)[..., None]
    probe = calibrate(candidates, thickness, state, 0.6)
    assert torch.equal(probe.gain, torch.ones(2))
    assert probe.classify(line_scores(torch.tensor([[[0.1], [0.1]]]), probe.gain)).item() == 2


def lines_of(opacity: torch.Tensor) -> torch.Tensor:
    return -torch.log1p(-opacity.clamp(max=0.999))[..., None]


def probe_of(noise: float = 0.0):
    candidates = build_candidates(STATES, CONFIG)
    state = torch.tensor([0, 1, 2]).repeat(30)
    scores = candidates.occupied[state] * 0.8
    scores = (scores + noise * torch.rand(scores.shape, generator=torch.Generator().manual_seed(0))).clamp(0, 0.999)
    return calibrate(candidates, lines_of(scores), state, 0.6), scores, state


def test_present_and_absent_are_told_apart_in_spite_of_noise():
    probe, scores, state = probe_of(noise=0.3)
    assert torch.equal(probe.classify(scores), state)


def test_autocast_changes_no_probability():
    probe, scores, _ = probe_of(noise=0.3)
    plain = probe.state_posterior(scores)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(probe.state_posterior(scores), plain)


def test_a_score_between_present_and_absent_is_unknown():
    probe, _, _ = probe_of()
    middle = probe.threshold.clone()
    assert probe.classify(middle[None]).item() == UNKNOWN


def test_two_boxes_at_once_fit_no_state():
    probe, _, _ = probe_of()
    assert probe.classify(torch.tensor([[0.8, 0.8]])).item() == UNKNOWN


def test_equal_states_share_their_probability():
    candidates = build_candidates([[NEAR], [NEAR], []], CONFIG)
    scores = torch.tensor([[0.9], [0.9], [0.1]]).repeat(10, 1)
    probe = calibrate(candidates, lines_of(scores), torch.tensor([0, 1, 2]).repeat(10), 0.6)
    # Two of the three states are the same situation: alone each has at most one half, together they are sure.
    assert probe.classify(torch.tensor([[0.9], [0.1]])).tolist() == [0, 2]


def test_a_useless_candidate_has_a_weak_vote():
    candidates = build_candidates(STATES, CONFIG)
    scores = torch.rand(60, 2, generator=torch.Generator().manual_seed(0)) * 0.02
    probe = calibrate(candidates, lines_of(scores), torch.tensor([0, 1, 2]).repeat(20), 0.6)
    assert set(probe.classify(scores).tolist()) == {UNKNOWN}


def test_no_boxes_is_a_sentence():
    with pytest.raises(UserError, match="names no actor boxes"):
        build_candidates([[], []], CONFIG)


def test_states_that_differ_in_what_does_not_matter_agree():
    probe, scores, state = probe_of()
    labels = torch.tensor([1, 1, 0])  # a truck somewhere, a truck somewhere, none
    assert torch.equal(probe.agreed(scores, labels), labels[state])
    halfway = 0.5 * (scores[:1] + scores[1:2])  # the near box and the far box half occupied: near, far or none?
    assert probe.classify(halfway).tolist() == [UNKNOWN]
    both = torch.maximum(scores[:1], scores[1:2])  # near or far: unknown which, but a truck
    assert probe.classify(both).tolist() == [UNKNOWN]
    assert probe.agreed(both, labels).tolist() == [1]
    assert probe.agreed(both, torch.tensor([0, 1, 0])).tolist() == [UNKNOWN]


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_a_field_that_broke_down_is_a_sentence(broken):
    candidates = build_candidates(STATES, CONFIG)
    thickness = torch.ones(3, 2, 6)
    thickness[1, 0, 2] = broken
    with pytest.raises(UserError, match="density is not finite: train it again"):
        calibrate(candidates, thickness, torch.tensor([0, 1, 2]), 0.6)
