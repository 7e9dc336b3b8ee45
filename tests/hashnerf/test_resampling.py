"""Strata of rays: equal shares of importance, lengths that add up, pieces that leave nothing out."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hashnerf.resampling import FLOOR, Strata, cut_pieces, draw_samples


def strata(start, dt, expected, mask=None, per_opacity=4.0, most=64):
    rows = [torch.tensor([row], dtype=torch.float32) for row in (start, dt, expected)]
    kept = torch.tensor([mask]) if mask else torch.ones_like(rows[0], dtype=torch.bool)
    return Strata.of(*rows, kept, per_opacity, most)


def test_counts_by_hand():
    # importance 0.75 + 0.25 and 0.25 + 0.25: the floor of 0.5 is spread over two intervals of equal length
    cut = strata([0, 1], [1, 1], [0.75, 0.25])
    assert torch.allclose(cut.importance, torch.tensor([[1.0, 0.5]]))
    assert cut.count.item() == 7  # 1.5 * 4 + 1
    start, dt, kept = cut_pieces(cut)
    # two thirds of seven pieces lie in the first metre: 4.67 of them, each 3/14 m long; the fifth runs over the border
    assert torch.allclose(dt[0, :4], torch.full((4,), 1.5 / 7))
    assert torch.allclose(start[0, 5], torch.tensor(1 + (5 * 1.5 / 7 - 1) / 0.5))
    assert kept.all() and dt.sum().item() == pytest.approx(2)


def test_samples_by_hand():
    samples = draw_samples(strata([0, 1], [1, 1], [0.0, 0.0], per_opacity=6.0), None)
    assert torch.allclose(samples.t, torch.tensor([[0.25, 0.75, 1.25, 1.75]]))
    assert torch.allclose(samples.dt, torch.full((1, 4), 0.5))


def test_pieces_begin_and_end_with_what_is_to_be_sampled():
    cut = strata([0, 1, 2, 3], [1, 1, 1, 1], [0.0, 0.5, 0.5, 0.0], mask=[False, True, True, False])
    start, dt, _ = cut_pieces(cut)
    assert start[0, 0].item() == pytest.approx(1)
    assert (start + dt)[0, -1].item() == pytest.approx(3)


def test_a_gap_between_intervals_belongs_to_the_piece_that_runs_over_it():
    cut = strata([0, 1, 2], [1, 1, 1], [0.5, 0.0, 0.5], mask=[True, False, True], per_opacity=2.0)
    start, dt, _ = cut_pieces(cut)
    assert cut.count.item() == 4
    assert torch.allclose(start + dt, torch.tensor([[0.5, 1.0, 2.5, 3.0]]), atol=1e-5)
    assert dt.sum().item() == pytest.approx(3), "end to end"


def test_a_ray_with_nothing_to_sample_gets_nothing():
    cut = strata([0, 1], [1, 1], [0.5, 0.5], mask=[False, False])
    assert not draw_samples(cut, None).mask.any()
    _, dt, kept = cut_pieces(cut)
    assert not kept.any() and dt.isfinite().all()
    none = Strata.of(*[torch.zeros(0, 3)] * 3, torch.zeros(0, 3, dtype=torch.bool), 4.0, 8)
    assert draw_samples(none, None).mask.shape[0] == 0 and cut_pieces(none)[2].shape[0] == 0


def test_places_of_padded_samples():
    rows = torch.tensor([[0.0, 1.0], [0.0, 1.0]])
    kept = torch.tensor([[True, True], [True, False]])
    samples = draw_samples(
        Strata.of(rows, torch.ones(2, 2), torch.tensor([[1.0, 1.0], [0.0, 0.0]]), kept, 1.0, 8), None
    )
    place, ray = samples.places()
    width = samples.mask.shape[1]
    assert ray.tolist() == [0] * 4 + [1] * 2
    assert torch.equal(place // width, ray)


@given(
    st.lists(st.tuples(st.floats(1e-3, 10), st.floats(0, 1), st.booleans()), min_size=1, max_size=30),
    st.integers(1, 40),
)
def test_lengths_and_order(rows, most):
    lengths, expected, mask = map(list, zip(*rows))
    start = torch.tensor([0.0, *lengths]).cumsum(dim=0)[:-1].tolist()
    cut = strata(start, lengths, expected, mask, most=most)
    samples, (begin, dt, kept) = draw_samples(cut, torch.Generator().manual_seed(0)), cut_pieces(cut)
    assert samples.mask.sum() <= most and kept.sum() == cut.count.sum()
    assert (samples.t.diff(dim=1)[samples.mask[:, 1:]] >= -1e-4).all()
    end = (begin + dt)[kept]
    assert torch.allclose(end[:-1], begin[kept][1:], atol=1e-4), "pieces lie end to end"
    if any(mask):
        first, last = mask.index(True), len(mask) - 1 - mask[::-1].index(True)
        assert begin[0, 0].item() == pytest.approx(start[first], abs=1e-4)
        assert end[-1].item() == pytest.approx(start[last] + lengths[last], rel=1e-4, abs=1e-3)
        assert cut.importance.sum().item() <= sum(expected) + FLOOR + 1e-4
