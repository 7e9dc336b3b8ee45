"""Hard views are drawn more often, every view is drawn, and a resumed run draws the same ones."""

import torch

from carff.view_priority import ViewPriority


def drawn(priority: ViewPriority, count: int = 20_000) -> list[float]:
    rows = priority.draw(count, torch.Generator().manual_seed(0))
    return (torch.bincount(rows, minlength=len(priority.errors)) / count).tolist()


def trained(hard_share: float, patience: int = 1) -> ViewPriority:
    priority = ViewPriority(4, hard_share, patience)
    rows = torch.arange(4)
    for _ in range(60):
        priority.record(rows, torch.tensor([0.0, 1.0, 2.0, 5.0]))
    return priority


def test_shares_by_hand():
    # 0.6 of the draws follow 0 : 1 : 2 : 5, the other 0.4 are even.
    expected = [0.1, 0.1 + 0.6 / 8, 0.1 + 1.2 / 8, 0.1 + 3.0 / 8]
    assert all(abs(a - b) < 0.02 for a, b in zip(drawn(trained(0.6)), expected))


def test_early_errors_and_share_zero_change_nothing():
    for priority in (ViewPriority(4, 0.7, 10), trained(0.0), trained(0.7, patience=100)):
        assert all(abs(share - 0.25) < 0.02 for share in drawn(priority))


def test_no_error_left_and_errors_that_are_not_finite():
    priority = trained(0.7)
    priority.errors.zero_()
    assert all(abs(share - 0.25) < 0.02 for share in drawn(priority))
    priority.record(torch.tensor([0, 1]), torch.tensor([torch.nan, torch.inf]))
    assert priority.errors.isfinite().all()
    first = ViewPriority(2, 0.7, 1)
    first.record(torch.tensor([0, 1]), torch.tensor([torch.nan, 3.0]))
    assert first.errors.tolist() == [3.0, 3.0]


def test_a_view_that_stands_twice_in_a_batch_counts_once_with_its_mean():
    priority = ViewPriority(3, 0.7, 1)
    priority.record(torch.tensor([0, 0, 1]), torch.tensor([2.0, 4.0, 0.0]))
    # All start at the batch's mean, 2; view 0 meets an error of 3, view 1 one of 0, view 2 none.
    assert torch.allclose(priority.errors, torch.tensor([0.7 * 2 + 0.3 * 3, 0.7 * 2, 2.0]))


def test_a_resumed_run_draws_the_same_views():
    priority, resumed = trained(0.7), ViewPriority(4, 0.7, 1)
    resumed.load_state_dict(priority.state_dict())
    assert drawn(priority) == drawn(resumed) != drawn(ViewPriority(4, 0.7, 1))
