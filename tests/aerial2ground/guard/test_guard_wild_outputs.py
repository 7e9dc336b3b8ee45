"""An armed guard and a policy that says anything at all: every byte that is sent is taken apart."""

import math
import random

from aerial2ground.guard.states import State
from tests.aerial2ground.guard.bench import ANSWER, BRAKE, RPM, SERVO, staged

SOUND_STEERING, SOUND_SPEED = [0.263, -0.263, 0.0, -0.0, 1e-9, 5e-324], [0.0, -0.0, 1.0, 1e-9, 5e-324]
WILD = [math.nan, math.inf, -math.inf, 1e9, -1e9, 0.2631, -0.2631, -1e-9, 1e308]
WILD_SPEED = [math.nan, math.inf, -math.inf, 1e9, -1e9, 1.0001, -1e-9, 1e308]


def output(chance: random.Random) -> tuple[float, float]:
    """Steering and speed, most of them sound, some at their limits, some wild."""
    steering, speed = chance.uniform(-0.263, 0.263), chance.uniform(0, 1)
    kind = chance.random()
    if kind < 0.002:
        return chance.choice(WILD), speed
    if kind < 0.004:
        return steering, chance.choice(WILD_SPEED)
    if kind < 0.1:
        return chance.choice(SOUND_STEERING), chance.choice(SOUND_SPEED)
    return steering, speed


def test_r08_a_hundred_thousand_random_outputs(bridge_row):
    chance, bench, wrong, stopped = random.Random(0), staged("armed"), 0, 0
    for _ in range(25_000):
        if bench.state is not State.ARMED:
            bench, stopped = staged("armed"), stopped + 1
        sound = True
        for _ in range(4):  # the policy asks 200 times a second
            steering, speed = output(chance)
            bench.now += 0.005
            bench.look()
            bench.send(steering, speed)
            sound = sound and abs(steering) <= 0.263 and 0 <= speed <= 1
        for payload in bench.car.says:
            bench.say("payload", payload.hex())
        bench.car.says = []
        bench.say("held")
        for kind, argument in bench.tick():
            wrong += kind == SERVO and not 150 <= argument <= 850
            wrong += kind == RPM and not (0 < argument <= 4614 and sound)
            wrong += kind not in (RPM, BRAKE, SERVO, ANSWER)
        wrong += sound != (bench.state is State.ARMED)
        bench.log.clear()
    assert stopped > 100
    bridge_row("R08", f"wrong frames in 1e5 random outputs, {stopped} of them wild", wrong, 0)
