"""Faults while the car drives: each is done to the bridge on the rig; the time to the first brake frame is measured."""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from aerial2ground.bridge.rig import Rig
from aerial2ground.bridge.trial_policies import Kind


@dataclass(frozen=True)
class Trial:
    """One fault."""

    name: str
    what: str
    """What is done."""
    allowed: float
    """Seconds to the first brake frame."""
    do: Callable[[Rig], None]
    policy: Kind = "constant"
    mend: Callable[[Rig], None] | None = None
    """Ends the fault, so that the car can be armed again; None: the bridge has ended."""


def _policy(number: signal.Signals) -> Callable[[Rig], None]:
    return lambda rig: os.kill(rig.policy_process(), number)


def _blacken(rig: Rig) -> None:
    rig.picture.black = True


def _shrink(rig: Rig) -> None:
    rig.picture.size = (18, 32)


def _silence(rig: Rig) -> None:
    rig.vesc.mode = "silent"


TRIALS = (
    Trial("kill", "the policy's process is killed", 0.15, _policy(signal.SIGKILL)),
    Trial(
        "stop", "the policy's process is stopped (SIGSTOP)", 0.15, _policy(signal.SIGSTOP), mend=_policy(signal.SIGCONT)
    ),
    Trial("exception", "the policy's process raises: a picture of another size", 0.15, _shrink),
    Trial("nan", "the network answers NaN", 0.15, _blacken, policy="nan_when_black"),
    Trial(
        "still",
        "the camera freezes: no more pictures",
        0.3,
        lambda r: r.stream.freeze("still"),
        mend=lambda r: r.stream.resume(),
    ),
    Trial(
        "repeat",
        "the camera freezes: one picture, again and again",
        0.3,
        lambda r: r.stream.freeze("repeat"),
        mend=lambda r: r.stream.resume(),
    ),
    Trial("unplug", "the camera is unplugged", 0.15, lambda r: r.stream.unplug()),
    Trial("e_stop", "emergency stop by the space bar", 0.05, lambda r: r.press(" "), mend=lambda r: None),
    Trial("dead_man", "the dead-man is let go", 0.1, lambda r: r.hold(False), mend=lambda r: None),
    Trial("telemetry", "the motor controller does not answer any more", 0.55, _silence, mend=lambda r: r.vesc.answer()),
)


def repeat(trial: Trial, make_rig: Callable[[Trial, int], Rig], times: int) -> list[float]:
    """Returns the seconds to the first brake frame of so many repetitions; infinite: none came.

    A new rig is made wherever the bridge has ended, or would have to be waited for.
    """
    took: list[float] = []
    while len(took) < times:
        with make_rig(trial, len(took)) as rig:
            rig.confirm_wheels()
            while len(took) < times:
                rig.arm()
                start = time.monotonic()
                trial.do(rig)
                took.append(rig.first_brake(start, trial.allowed))
                rig.hold(False)
                if trial.mend is None:
                    break
                trial.mend(rig)
                rig.wait_for(lambda: abs(rig.vesc.state.speed) < 0.01, "standing")
                time.sleep(0.3)
    return took
