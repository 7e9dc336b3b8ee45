"""The mechanics of timing, by a clock that is told what to say."""

import numpy as np
import pytest
import torch

from aerial2ground.latency import latency_ms
from hashnerf.errors import UserError

PICTURE = np.zeros((2, 3, 3), np.uint8)


class Clock:
    """A clock that only a `Worker` moves."""

    def __init__(self):
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def worker(clock, seconds, calls):
    def answer(picture):
        clock.now += seconds[len(calls)]
        calls.append((picture is PICTURE, torch.get_num_threads()))

    return answer


def test_median_and_99th_percentile_without_the_warm_up():
    clock, calls = Clock(), []
    # three slow calls to warm up; then 1, 2, ... 101 ms: the median is 51 and a hundredth lies above 100
    seconds = [9.0] * 3 + [count / 1000 for count in range(1, 102)]
    found = latency_ms(worker(clock, seconds, calls), PICTURE, frames=101, warm_up=3, clock=clock)
    assert found.median == pytest.approx(51) and found.p99 == pytest.approx(100)
    assert calls == [(True, 1)] * 104


def test_the_number_of_threads_is_restored_after_an_error_too():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        latency_ms(lambda picture: None, PICTURE, frames=1)
        assert torch.get_num_threads() == 2
        with pytest.raises(ZeroDivisionError):
            latency_ms(lambda picture: 1 / 0, PICTURE)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("changes", [{"frames": 0}, {"warm_up": -1}])
def test_measuring_nothing_is_refused(changes):
    with pytest.raises(UserError, match="measure nothing"):
        latency_ms(lambda picture: None, PICTURE, **changes)
