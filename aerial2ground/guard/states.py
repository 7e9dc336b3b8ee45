"""The guard's states and what every event does in each of them: all transitions that there are.

Motion frames are sent in ARMED only. STOPPING brakes until the car stands. FAULT is latched: only arming leaves it.
"""

import enum


class State(enum.Enum):
    """Where the guard is."""

    DISARMED = "DISARMED"
    READY = "READY"
    ARMED = "ARMED"
    STOPPING = "STOPPING"
    FAULT = "FAULT"


class Event(enum.Enum):
    """What can happen."""

    ARM = "the operator says arm, and all conditions have been met for a second"
    UNREADY = "a condition is not met any more, or nobody took the dead-man in time"
    HELD = "the dead-man was let go and is held now"
    STOP = "the dead-man is let go, or the operator or the system asks for a stop"
    FAULT = "something is wrong"
    HALTED = "the stop sequence is over, no fault is latched"
    HALTED_BY_FAULT = "the stop sequence is over, a fault is latched"


_D, _R, _A, _S, _F = State
TRANSITIONS: dict[State, dict[Event, State]] = {
    state: dict(zip(Event, following))
    for state, following in {
        #    ARM UNREADY HELD STOP FAULT HALTED HALTED_BY_FAULT
        _D: (_R, _D, _D, _D, _F, _D, _F),
        _R: (_R, _D, _A, _D, _F, _D, _F),
        _A: (_A, _A, _A, _S, _S, _A, _A),
        _S: (_S, _S, _S, _S, _S, _D, _F),
        _F: (_R, _F, _F, _F, _F, _F, _F),
    }.items()
}
