import numpy as np
import pytest

from aerial2ground.bridge.latency_budget import STAGES, budget, stage_times
from aerial2ground.bridge.wire import Received
from aerial2ground.guard.messages import Command
from aerial2ground.guard.vesc import SET_SERVO, FrameParser, set_servo
from hashnerf.errors import UserError

SERVO = FrameParser().feed(set_servo(0.5), 0.0)[0]
assert SERVO[0] == SET_SERVO


def record(time, *commands):
    """A period at `time` that took in commands (number, picture, taken, sent, heard)."""
    taken_in = [
        [heard, "message", Command(number, picture, taken, sent, 0.0, 0.5).packed().hex()]
        for number, picture, taken, sent, heard in commands
    ]
    return {"t": time, "in": [*taken_in, [time, "word", "held"]], "out": "02"}


def test_stages_by_hand():
    # shown at 1, here 2 ms later, sent 1 ms after that, heard .5 ms later, period 6.5 ms later, read 1 ms after that
    records = [record(1.01, (1, 7, 1.002, 1.003, 1.0035))]
    received = [Received(0.9, SERVO), Received(1.011, SERVO), Received(1.031, SERVO)]
    times = stage_times(records, {7: 1.0}, received)
    np.testing.assert_allclose(times, [[2, 1, 0.5, 6.5, 1, 11]], atol=1e-9)
    lines = budget(np.concatenate([times, times * 3, times * 2]))
    assert [line[0] for line in lines] == list(STAGES)
    assert lines[-1][1] == pytest.approx(22) and lines[-1][2] == pytest.approx(22 + 0.98 * 11)


def test_only_the_first_command_of_a_picture_that_was_shown_counts():
    records = [record(1.01, (1, 7, 1.0, 1.0, 1.0), (2, 8, 1.0, 1.0, 1.0)), record(1.03, (3, 7, 1.0, 1.02, 1.02))]
    received = [Received(time, SERVO) for time in (0.9, 1.011, 1.031)]
    assert len(stage_times(records, {7: 1.0}, received)) == 1


def test_periods_before_and_after_what_was_received_do_not_count():
    records = [record(1.01, (1, 7, 1.0, 1.0, 1.0)), record(1.03, (2, 8, 1.02, 1.02, 1.02))]
    assert not len(stage_times(records, {7: 1.0, 8: 1.02}, [Received(1.02, SERVO)]))
    with pytest.raises(UserError, match="no picture of the log"):
        budget(stage_times(records, {}, []))
