"""The closed-loop world without pictures: one ego on its route, other actors on theirs, and a command to go or to stop.

Arc lengths s in metres along each route, speeds in m/s. Command *go*: accelerate to the nominal speed. Command *stop*:
brake so gently that the front comes to rest at the stop line; an ego past the line, or unable to stop there, is
committed and drives on. Other actors drive at constant speed and do not react.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from hashnerf.errors import UserError
from worlds.boxes import box_at
from worlds.scene import World

STANDSTILL = 0.05  # m/s
ROUNDING = 1e-6  # metres


@dataclass(frozen=True)
class DrivingConfig:
    """How the ego drives, and how much episodes differ."""

    acceleration: float = 2.0
    """Of the ego when it goes, m/s^2."""
    comfortable_braking: float = 3.0
    """Braking towards the stop line, m/s^2."""
    hardest_braking: float = 6.0
    """Braking beyond which stopping before the line is given up, m/s^2."""
    tick: float = 0.05
    """Seconds between updates of the motion."""
    decision_ticks: int = 8
    """Ticks between two decisions."""
    longest: float = 25.0
    """Seconds after which an episode ends."""
    start_jitter: float = 1.5
    """Largest random shift of every start position, metres."""
    speed_jitter: float = 0.1
    """Largest random change of every speed, as a share."""

    def __post_init__(self):
        for name in ("acceleration", "comfortable_braking", "hardest_braking", "tick", "longest"):
            if not 0 < getattr(self, name) < math.inf:
                raise UserError(f"driving.{name} is {getattr(self, name)}; give a positive number")
        if self.decision_ticks < 1:
            raise UserError(f"driving.decision_ticks is {self.decision_ticks}; give at least 1")


@dataclass(frozen=True)
class Setup:
    """What chance fixes at the start of an episode."""

    branch: int
    start: dict[str, float] = field(default_factory=dict)
    speed: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Drive:
    """One moment of an episode."""

    setup: Setup
    time: float
    s: float
    speed: float
    stood: bool = False
    collided: bool = False
    crossed: float | None = None
    """Time at which the ego had left the last conflict zone."""

    @property
    def over(self) -> bool:
        """Whether nothing more can happen."""
        return self.collided or self.crossed is not None


def draw_setup(world: World, config: DrivingConfig, rng: np.random.Generator) -> Setup:
    """Draws the branch, start positions and speeds of an episode."""
    traffic = world.traffic
    branch = int(rng.integers(len(world.branches)))
    first = min(step for own, step, _ in traffic.starts if own == branch)
    start, speed = {}, {}
    for name in world.actors:
        shift, factor = rng.uniform(-1, 1), rng.uniform(-1, 1)  # drawn for absent actors too: branches stay comparable
        if (branch, first, name) in traffic.starts:
            start[name] = traffic.starts[branch, first, name] + config.start_jitter * shift
            speed[name] = traffic.speeds[branch, name] * (1 + config.speed_jitter * factor)
    return Setup(branch, start, speed)


def begin(setup: Setup) -> Drive:
    """Returns the first moment of an episode."""
    return Drive(setup, 0.0, setup.start["ego"], setup.speed["ego"])


def actor_poses(world: World, setup: Setup, time: float) -> dict:
    """Returns where every actor but the ego stands at a time."""
    return {
        name: world.traffic.routes[name].pose(start + setup.speed[name] * time)
        for name, start in setup.start.items()
        if name != "ego"
    }


def can_stop(world: World, drive: Drive, config: DrivingConfig) -> bool:
    """Whether the ego can still come to rest at the stop line."""
    room = world.traffic.stop - drive.s
    return room >= -ROUNDING and hardest_stop(drive.speed, config) <= room + ROUNDING


def stop_matters(world: World, drive: Drive, config: DrivingConfig) -> bool:
    """Whether *stop* and *go* could differ before the next decision: far from the line both keep the nominal speed."""
    if not can_stop(world, drive, config):
        return False
    reach = drive.setup.speed["ego"] * config.tick * config.decision_ticks
    room = world.traffic.stop - drive.s - reach
    return stopping_speed(room, config) < drive.setup.speed["ego"]


def stopping_speed(room: float, config: DrivingConfig) -> float:
    """The speed (m/s) from which comfortable braking, tick by tick, comes to rest within `room` metres.

    Speeds v, v - b dt, v - 2 b dt, ... cover v^2 / (2 b) + v dt / 2 in all. The second term matters: without it the
    last ticks overshoot the line, and an ego beyond the line drives on.
    """
    room = max(room, 0.0)
    half = config.comfortable_braking * config.tick / 2
    return min(math.sqrt(half**2 + 2 * config.comfortable_braking * room) - half, room / config.tick)


def hardest_stop(speed: float, config: DrivingConfig) -> float:
    """The metres that braking as hard as possible still takes, tick by tick: v - h dt, v - 2 h dt, ... down to 0."""
    ticks, rest = divmod(speed / (config.hardest_braking * config.tick), 1.0)
    return config.hardest_braking * config.tick**2 * (ticks * (ticks - 1) / 2 + ticks * rest)


def advance(world: World, drive: Drive, go: bool, config: DrivingConfig) -> Drive:
    """Returns the moment one tick later; an ego that cannot stop any more goes, whatever the command."""
    go = go or not can_stop(world, drive, config)
    target = nominal = drive.setup.speed["ego"]
    if not go:
        target = min(nominal, stopping_speed(world.traffic.stop - drive.s, config))
    change = target - drive.speed
    change = min(max(change, -config.hardest_braking * config.tick), config.acceleration * config.tick)
    speed = max(drive.speed + change, 0.0)
    if not go and speed < STANDSTILL:
        speed = 0.0
    s, time = drive.s + speed * config.tick, drive.time + config.tick
    ends = [interval[0][1] for interval in world.traffic.conflicts.values()]
    return replace(
        drive,
        time=time,
        s=s,
        speed=speed,
        stood=drive.stood or speed < STANDSTILL,
        collided=touches(world, drive.setup, s, time),
        crossed=time if s > max(ends) else None,
    )


def touches(world: World, setup: Setup, s: float, time: float) -> bool:
    """Whether the ego's body at s touches another actor at a time."""
    routes = world.traffic.routes
    for name, start in setup.start.items():
        if name == "ego":
            continue
        place = start + setup.speed[name] * time
        (low, high), (other_low, other_high) = world.traffic.conflicts[name]
        # Outside the conflict zone the bodies cannot meet: no need to build boxes.
        if low <= s <= high and other_low <= place <= other_high:
            ego = box_at(routes["ego"].pose(s), world.actors["ego"].size)
            if ego.overlaps(box_at(routes[name].pose(place), world.actors[name].size)):
                return True
    return False


def going_is_safe(world: World, drive: Drive, config: DrivingConfig, margin: float = 0.3) -> bool:
    """Whether going on from here without any stop touches nobody, now or `margin` seconds earlier or later.

    This is the all-seeing oracle's rule: it knows every actor's position and speed.
    """
    while not drive.over and drive.time < config.longest:
        drive = advance(world, drive, True, config)
        if any(touches(world, drive.setup, drive.s, max(drive.time + shift, 0.0)) for shift in (-margin, 0.0, margin)):
            return False
    return True
