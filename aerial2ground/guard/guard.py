"""What is sent to the motor controller: a pure function of what happened and when, so that a log can be replayed.

Whoever drives it (`guard_process`) reports messages, answers, the operator's words and lost links as they come, and
calls `tick` every 20 ms, and at once after an emergency stop, for the frames that are due.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from aerial2ground.guard.actuation import Actuation
from aerial2ground.guard.arming import HELD, DeadMan, TimeoutProbe, WheelCheck, self_test
from aerial2ground.guard.faults import Fault
from aerial2ground.guard.health import STILL, VALUES_SLOW, CommandWatch, ControllerWatch, Since
from aerial2ground.guard.messages import READY
from aerial2ground.guard.set_point import SetPoint
from aerial2ground.guard.states import TRANSITIONS, Event, State
from aerial2ground.guard.vesc import (
    FW_VERSION,
    GET_VALUES,
    query,
    read_firmware,
    read_values,
    set_brake,
    set_current,
    set_rpm,
    set_servo,
)

LATE = 0.1
ASK_AGAIN = 0.1
MET, READY_LIMIT = 1.0, 30.0
SHORTEST_STOP, STANDING, BLIND_STOP = 0.5, 0.2, 3.0
"""Seconds: of braking at least; of standing that end it; of braking where the controller does not answer."""
ROLLING_ERPM = 500
"""Faster than this the wheels are not turned without a command."""
OLDEST_FIRMWARE = 3


@dataclass(frozen=True)
class GuardSettings:
    """What the operator chose."""

    accept_esc_timeout: float = 0.0
    """Seconds of the controller's own timeout that are accepted, if more than 0.25; infinite accepts none at all."""
    time_limit: float = 600.0
    """Seconds after which a drive is ended."""


class Guard:
    """The state machine and its outputs; times are monotonic seconds that never go back."""

    def __init__(self, actuation: Actuation, settings: GuardSettings):
        self.state, self.fault = State.DISARMED, None
        self.notes: list[str] = []
        """Sentences for the operator; whoever prints them empties the list."""
        self.firmware: tuple[int, int, str] | None = None
        self.commands, self.controller = CommandWatch(actuation), ControllerWatch(actuation)
        self.point, self.dead_man = SetPoint(actuation), DeadMan()
        self.wheels = WheelCheck(actuation.steering_limit)
        self.probe, self._told = TimeoutProbe(settings.accept_esc_timeout), False
        self._car, self._settings = actuation, settings
        self._failed_tests = self_test(actuation)
        self.policy_ready = self._linked = False
        self._met = Since()
        self._met_for = 0.0
        self._ticked = self._asked = -math.inf
        self._entered = -math.inf
        """When the state was entered."""

    def take(self, kind: str, value: str, now: float) -> None:
        """Takes in what happened, in the words in which the black box keeps it; raises KeyError for another kind."""
        {
            "message": lambda: self.on_message(bytes.fromhex(value), now),
            "payload": lambda: self.on_payload(bytes.fromhex(value), now),
            "word": lambda: self.on_operator(value, now),
            "link": lambda: self.on_link(value == "up", now),
            "fault": lambda: self.raise_fault(Fault[value], now),
        }[kind]()

    def on_link(self, linked: bool, now: float) -> None:
        """A port was opened, or is gone; a controller behind a new one has to prove itself anew."""
        self.firmware, self._linked, self._asked = None, linked, -math.inf
        self.controller = ControllerWatch(self._car)
        self.probe, self._told = TimeoutProbe(self._settings.accept_esc_timeout), False
        self.wheels = WheelCheck(self._car.steering_limit)
        if not linked or self.state is State.ARMED:  # armed was another controller than the one that is there now
            self.raise_fault(Fault.LINK_LOST, now)

    def on_payload(self, payload: bytes, now: float) -> None:
        """The controller answered something."""
        values = read_values(payload)
        if values is not None:
            self.controller.accept(values, now)
            self.probe.accept(values, now)
        elif self.firmware is None:
            self.firmware = read_firmware(payload)

    def on_message(self, message: bytes, now: float) -> None:
        """The policy's process sent something."""
        if message == READY:
            self.policy_ready = True
            return
        wrong = self.commands.accept(message, now)
        if wrong:
            self.raise_fault(Fault.BAD_COMMAND, now, f" ({wrong})")

    def on_operator(self, word: str, now: float) -> None:
        """The operator said a word, or gave a sign of the dead-man."""
        actions = {
            "held": lambda: self.dead_man.sign(now),
            "released": self.dead_man.release,
            "estop": lambda: self.raise_fault(Fault.E_STOP, now),
            "stop": lambda: self._happen(Event.STOP, now, "stop"),
            "arm": lambda: self._arm(now),
            "check": lambda: self._check_wheels(now),
            "yes": lambda: self._answer(True, now),
            "no": lambda: self._answer(False, now),
        }
        action = actions.get(word)
        if action is None:
            self.notes.append(
                f"{word!r} is no command; say check, yes, no, arm, stop or quit; the space bar stops at once"
            )
        else:
            action()

    def raise_fault(self, fault: Fault, now: float, detail: str = "") -> None:
        """Latches a fault and stops; a later fault does not hide the first."""
        if self.fault is None:
            self.fault = fault
            self.notes.append(f"{fault.name}{detail}: {fault.value}")
        self._happen(Event.FAULT, now, fault.name)

    def lacks(self, now: float) -> Iterator[str]:
        """What is missing before the car may be armed (R02)."""
        for test in self._failed_tests:
            yield f"a guard that passes its own test of {test}"
        if self.firmware is None:
            yield "a motor controller on the port"
        elif self.firmware[0] < OLDEST_FIRMWARE:
            yield f"a controller with firmware {OLDEST_FIRMWARE} or newer (it has {self.firmware[0]})"
        if not self.policy_ready:
            yield "a policy that is loaded"
        yield from self.commands.lacks(now)
        yield from self.controller.lacks(now)
        yield from self.probe.lacks()
        if not self.wheels.confirmed:
            yield "a look at the wheels (say check, then yes)"

    def tick(self, now: float) -> list[bytes]:
        """Returns the frames that are due; to be called every 20 ms, and at once when something must be stopped."""
        self._judge(now)
        if not self._linked:
            return []
        if self.firmware is None or self.firmware[0] < OLDEST_FIRMWARE:  # to which our numbers may mean other things
            if now - self._asked < ASK_AGAIN:
                return []
            self._asked = now
            return [query(FW_VERSION)]
        if not self.policy_ready:
            return []
        # a car that may still roll is braked, not measured
        if self.state is State.STOPPING or not abs(self._car.erpm(self.controller.speed(now))) < STILL:
            self.probe.begin_anew()
        elif (probing := self.probe.frames(now)) is not None:
            return probing
        if not self._told and self.probe.seconds is not None:
            self._told = True
            self.notes.append(self.probe.finding())
        motor = self._drive(now) if self.state is State.ARMED else self._stand(now)
        servo = min(max(self._car.servo(self.point.steering), self._car.servo_min), self._car.servo_max)
        return [motor, set_servo(servo), query(GET_VALUES)]

    def _judge(self, now: float) -> None:
        """Looks at everything once a period and lets happen what follows."""
        late = now - self._ticked > LATE
        self._ticked = now
        self._met_for = self._met(next(self.lacks(now), None) is None, now)
        standing = self.controller.still_for(now)
        # every period, so that what has to last for a while is timed, whatever the state
        broken = self.controller.fault(self.point.speed, now)
        if self.state is State.ARMED:
            fault = Fault.GUARD_LATE if late else self.commands.fault(now) or broken
            if fault is not None:
                self.raise_fault(fault, now)
            elif not self.dead_man.is_held(now):
                self._happen(Event.STOP, now, "the dead-man was let go")
            elif not now - self._entered <= self._settings.time_limit:  # so that NaN ends it, too
                self._happen(Event.STOP, now, f"{self._settings.time_limit:g} s are over")
        elif self.state is State.STOPPING:
            self._end_stop(standing, now)
        elif broken is Fault.SPEED_MISMATCH:
            self.raise_fault(Fault.ROLLING, now)
        elif self.state is State.READY:
            self._leave_ready(now)

    def _leave_ready(self, now: float) -> None:
        lacking = next(self.lacks(now), None)
        held = self.dead_man.is_held(now) and self.dead_man.since > self._entered
        if lacking is not None:
            self._happen(Event.UNREADY, now, f"it lacks {lacking}")
        elif held and now - self.dead_man.since >= HELD:
            self._happen(Event.HELD, now, "the dead-man is held")
        elif now - self._entered > READY_LIMIT:
            self._happen(Event.UNREADY, now, "nobody took the dead-man")

    def _end_stop(self, standing: float, now: float) -> None:
        blind = self.controller.speed(now) == math.inf
        took = now - self._entered
        if took >= SHORTEST_STOP and (standing >= STANDING or (blind and took >= BLIND_STOP)):
            why = "nothing is known of the wheels: THE CAR MAY STILL ROLL" if blind else "the car stands"
            self._happen(Event.HALTED if self.fault is None else Event.HALTED_BY_FAULT, now, why)

    def _drive(self, now: float) -> bytes:
        command = self.commands.command
        if command is None or self.commands.slow(now) or self.controller.age(now) > VALUES_SLOW:
            self.point.ramp_down(now)
        else:
            self.point.follow(command.steering, command.speed, now)
        erpm = round(self._car.erpm(self.point.speed))
        return set_rpm(float(erpm)) if erpm > 0 else set_brake(self._car.brake_current)

    def _stand(self, now: float) -> bytes:
        erpm = abs(self._car.erpm(self.controller.speed(now)))
        self.point.stand(self.point.steering if erpm > ROLLING_ERPM else self.wheels.angle(now), now)
        brakes = self.state is State.STOPPING or erpm >= STILL
        return set_brake(self._car.brake_current) if brakes else set_current(0.0)

    def _arm(self, now: float) -> None:
        lacking = list(self.lacks(now))
        if self.state not in (State.DISARMED, State.FAULT):
            self.notes.append(f"the car is {self.state.value}: nothing to arm")
        elif lacking:
            self.notes.append("not armed; it lacks " + "; ".join(lacking))
        elif self._met_for < MET:
            self.notes.append(
                f"not armed; all conditions must hold for {MET:g} s, they do for {self._met_for:.1f}: say arm again"
            )
        else:
            self.fault = None
            self._happen(Event.ARM, now, f"hold the dead-man within {READY_LIMIT:g} s, and while the car drives")

    def _check_wheels(self, now: float) -> None:
        if not self._linked:
            self.notes.append("no motor controller is connected: no wheel can turn")
        elif self.state in (State.DISARMED, State.FAULT):
            self.wheels.begin(now)
            self.notes.append("the wheels turn left, then right: say yes if they did, no if not")
        else:
            self.notes.append(f"the car is {self.state.value}: say stop before the wheels are tried")

    def _answer(self, well: bool, now: float) -> None:
        if not self.wheels.answer(well, now):
            self.notes.append("say check first, and look at the wheels until they stand straight")
        elif well:
            self.notes.append("good; in a second say arm")
        else:
            self.raise_fault(Fault.WRONG_CALIBRATION, now)

    def _happen(self, event: Event, now: float, why: str) -> None:
        following = TRANSITIONS[self.state][event]
        if following is not self.state:
            self.notes.append(f"{self.state.value} -> {following.value}: {why}")
            self.state, self._entered = following, now
