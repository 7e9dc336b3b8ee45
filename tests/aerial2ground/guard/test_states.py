"""The table of transitions, against one that is written down here anew, and a walk of random events through it."""

import random

import pytest

from aerial2ground.guard.faults import Fault
from aerial2ground.guard.guard import Guard, GuardSettings
from aerial2ground.guard.states import TRANSITIONS, Event, State
from tests.aerial2ground.guard.bench import CAR, Bench, answer, command, is_motion, staged, taken_apart

MODEL = {
    ("DISARMED", "ARM"): "READY",
    ("DISARMED", "FAULT"): "FAULT",
    ("DISARMED", "HALTED_BY_FAULT"): "FAULT",
    ("READY", "UNREADY"): "DISARMED",
    ("READY", "STOP"): "DISARMED",
    ("READY", "HALTED"): "DISARMED",
    ("READY", "HELD"): "ARMED",
    ("READY", "FAULT"): "FAULT",
    ("READY", "HALTED_BY_FAULT"): "FAULT",
    ("ARMED", "STOP"): "STOPPING",
    ("ARMED", "FAULT"): "STOPPING",
    ("STOPPING", "HALTED"): "DISARMED",
    ("STOPPING", "HALTED_BY_FAULT"): "FAULT",
    ("FAULT", "ARM"): "READY",
}
"""Everything that changes the state. Nothing else does."""
WAYS = {("DISARMED", "READY"), ("READY", "DISARMED"), ("READY", "ARMED"), ("ARMED", "STOPPING"), ("FAULT", "READY")}
WAYS |= {("STOPPING", "DISARMED"), ("STOPPING", "FAULT"), ("DISARMED", "FAULT"), ("READY", "FAULT")}


def test_r33_every_event_has_its_transition_in_every_state(bridge_row):
    wrong = 0
    for state in State:
        for event in Event:
            expected = MODEL.get((state.name, event.name), state.name)
            wrong += TRANSITIONS[state][event].name != expected
    assert set(TRANSITIONS) == set(State)
    bridge_row("R33", "35 entries of the table, against one written anew", wrong, 0)


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("event", list(Event))
def test_the_guard_follows_the_table(state, event):
    guard = Guard(CAR, GuardSettings())
    guard.state = state
    guard._happen(event, 5.0, "for a test")
    assert guard.state.name == MODEL.get((state.name, event.name), state.name)
    changed = guard.state is not state
    assert guard.notes == ([f"{state.value} -> {guard.state.value}: for a test"] if changed else [])
    assert guard._entered == (5.0 if changed else -float("inf"))


def test_r33_only_what_happened_on_the_way_to_armed_leads_there(bridge_row):
    others = [state for state in State if state is not State.ARMED]
    ways = {(one.name, event.name) for one in others for event in Event if TRANSITIONS[one][event] is State.ARMED}
    bridge_row("R33", "ways into ARMED but the dead-man held in READY", len(ways - {("READY", "HELD")}), 0)


class Walk:
    """Random events on a bench, mostly what lets the car drive, and what the guard may do after each."""

    def __init__(self, seed: int):
        self.chance, self.bench, self.visits = random.Random(seed), Bench(), set()
        self.steps = self.events = 0
        self.wrong = 0

    def happen(self) -> None:
        """One random event and its consequences."""
        bench, chance, before, happened = self.bench, self.chance, self.bench.state, self.bench.happened
        kind = chance.random()
        if kind < 0.03:
            self.mishap()
        elif kind < 0.08:
            bench.say(chance.choice(["check", "yes", "arm", "arm", "arm", "held", "released", "stop", "no"]))
        elif kind < 0.11:
            bench.hand = chance.random() < 0.8
        elif kind < 0.13:
            self.bench.steering, bench.speed = chance.uniform(-0.263, 0.263), chance.uniform(0, 1)
        elif kind < 0.15:
            bench.policy_lives, bench.camera_lives = chance.random() < 0.9, chance.random() < 0.9
        else:
            bench.now += chance.choice([0.02, 0.02, 0.02, 0.005, 0.06])
            bench.events()
        self.check(before)
        self.steps += 1
        self.events += bench.happened - happened

    def mishap(self) -> None:
        bench, chance = self.bench, self.chance
        what = chance.randrange(8)
        if what == 0:
            bench.say("fault", chance.choice(list(Fault)).name)
        elif what == 1:
            bench.say("link", chance.choice(["up", "down"]))
        elif what == 2:
            bench.say("message", chance.choice([b"", b"ready", command(1, 1, 9e9, 1, 0, 5)]).hex())
        elif what == 3:
            bench.say("payload", chance.choice([answer(30_000), answer(fault=3), b"\x00\x06\x02", b"\x04"]).hex())
        elif what == 4:
            bench.say("estop")
        elif what == 5:
            bench.say("rubbish")
        elif what == 6:
            bench.now += chance.choice([0.3, 1.0])
        else:
            bench.say("link", "up")

    def check(self, before: State) -> None:
        """The state went a way that there is; then the cycle: motion in ARMED only, and never with a fault."""
        bench = self.bench
        after_event = bench.state
        frames = bench.tick()
        self.visits |= {(before.name, after_event.name), (after_event.name, bench.state.name)}
        moves = any(is_motion(*one) for one in frames)
        self.wrong += moves and (bench.state is not State.ARMED or bench.guard.fault is not None)
        self.wrong += bench.state is State.ARMED and bench.guard.fault is not None


def test_r33_a_hundred_thousand_random_events(bridge_row):
    visits, wrong, events = set(), 0, 0
    for seed in range(25):
        walk = Walk(seed)
        while walk.events < 4000:
            if walk.steps % 250 == 0:  # else nearly all events would happen to a car that lacks something
                walk.bench = staged(walk.chance.choice(["checked", "ready", "ready", "armed", "driving"]))
            walk.happen()
        visits, wrong, events = visits | walk.visits, wrong + walk.wrong, events + walk.events
    changes = {(one, other) for one, other in visits if one != other}
    assert events >= 100_000
    assert changes == WAYS  # all of them happened, and no other
    bridge_row("R33", "motion outside ARMED, or with a fault latched, in 1e5 random events", wrong, 0)


def test_motion_of_every_kind_would_be_noticed():
    assert is_motion(8, 1) and is_motion(6, 1) and is_motion(5, -1) and is_motion(30, 1)
    assert not is_motion(8, 0) and not is_motion(6, 0) and not is_motion(12, 530) and not is_motion(7, 10_000)
    with pytest.raises((AssertionError, KeyError)):
        taken_apart(bytes.fromhex("02011ef3ff03"))  # ALIVE
