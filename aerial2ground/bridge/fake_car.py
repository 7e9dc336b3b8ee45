"""A simulated car around a fake motor controller: it moves as the motor and the servo do, and its camera streams.

Time is the clock's: whoever drives it drives through a serial port and a picture stream, as on a car. Laps, errors and
interventions are counted as in `driving.drive`, once per picture, while the car rolls.
"""

import math
import os
import select
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath

import numpy as np
from jaxtyping import UInt8

from aerial2ground.bridge.car_file import load_car
from aerial2ground.bridge.fake_vesc import FakeVesc, Motor
from aerial2ground.bridge.picture_stream import PictureStream
from aerial2ground.car import CarConfig, CarState, footprint
from aerial2ground.config import AerialConfig
from aerial2ground.deployment import Deployment
from aerial2ground.driving import DriveConfig, Look, Touches, disturbed_start
from aerial2ground.learning_stages import origin_of, town_of
from aerial2ground.paths import Path
from aerial2ground.stages import load_driven_survey
from hashnerf.command_line import nearest
from hashnerf.errors import UserError

ROLLING = 0.01
"""m/s above which moments count: a car that waits makes no errors."""

Show = Callable[[UInt8[np.ndarray, "h w 3"], float], None]


@dataclass(frozen=True)
class FakeCarConfig(AerialConfig):
    """The pipeline's config, and how the simulated car behaves."""

    trajectory: str = "outer_loop"
    """Which path of the data set is driven."""
    laps: int = 2
    """Laps of a closed path after which it ends."""
    seconds: float = 0.0
    """It also ends after this long; 0: never."""
    car_file: str = "configs/cars/mini_city.yaml"
    """What motor and servo of the simulated car do with commands: a car's file."""
    rate: float = 30.0
    """Pictures a second."""
    link: str = ""
    """A symbolic link that always leads to the serial port; empty: none."""
    out: str = ""
    """JSON file for the summary; empty: none."""
    esc_timeout: float = 0.2
    """Seconds without a command after which the motor controller brakes by itself; 0: never."""
    esc_brake: float = 10.0
    """Amperes of that braking; 0: the car rolls on."""
    delay: float = 2.0
    """Milliseconds until the motor controller answers."""
    drop: float = 0.0
    """Share of its answers that are lost."""
    corrupt: float = 0.0
    """Share of its answers with a wrong bit."""

    def __post_init__(self):
        super().__post_init__()
        if self.laps < 1:
            raise UserError(f"laps is {self.laps}; give at least 1")
        if not 1 <= self.rate <= 200:
            raise UserError(f"rate is {self.rate}; give 1 to 200 pictures a second")
        for key, most in (("esc_timeout", 60), ("esc_brake", 100), ("delay", 500), ("drop", 1), ("corrupt", 1)):
            if not 0 <= getattr(self, key) <= most:
                raise UserError(f"{key} is {getattr(self, key)}; give 0 to {most}")
        if not 0 <= self.seconds < math.inf:
            raise UserError(f"seconds is {self.seconds}; give a positive number, or 0 for no end")


@dataclass(frozen=True)
class Summary:
    """What happened."""

    laps: int
    """Whole laps; 1 where an open path was driven to its end."""
    seconds: float
    """From the first motion on."""
    lap_seconds: list[float]
    """Of every lap."""
    distance: float
    """Metres along the path."""
    interventions: int
    """How often the car was put back."""
    put_back: list[tuple[float, float]]
    """Where."""
    position_rmse: float | None
    """Metres; None where the car did not move."""
    yaw_rmse: float | None
    """Degrees; None where the car did not move."""
    pictures: int
    """Taken, of which the camera may have sent fewer."""


@dataclass
class _Count:
    """What is counted on the way."""

    lateral: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)
    put_back: list[tuple[float, float]] = field(default_factory=list)
    lap_ends: list[float] = field(default_factory=list)
    travelled: float = 0.0
    pictures: int = 0
    began: float | None = None
    arrived: bool = False


class SimulatedCar:
    """Moves with a fake motor, starting at rest; `wheelbase` is the true one (m), `body` the body that may touch."""

    def __init__(
        self,
        motor: Motor,
        path: Path,
        drive: DriveConfig,
        body: CarConfig,
        wheelbase: float,
        start: CarState,
        look: Look,
        touches: Touches,
        show: Show,
    ) -> None:
        self.path, self.drive, self.body, self.wheelbase = path, drive, body, wheelbase
        self._look, self._touches, self._show = look, touches, show
        self._lock = threading.Lock()
        self._state = replace(start, speed=0.0, steering=motor.steering)
        self._motor = motor
        self._last = path.nearest(start.pose[:2])[0]
        self._count = _Count()
        motor.on_motion = self._roll

    @property
    def state(self) -> CarState:
        """Pose, speed and steering angle now."""
        with self._lock:
            return self._state

    def _roll(self, way: float, steering: float, now: float) -> None:
        with self._lock:
            self._state = rolled(self._state, way, steering, self._motor.speed, self.wheelbase)

    def run(
        self,
        rate: float,
        stop: threading.Event,
        seconds: float = math.inf,
        on_lap: Callable[[int, float, int], None] = lambda lap, seconds, interventions: None,
        on_moment: Callable[[], None] = lambda: None,
    ) -> Summary:
        """Takes `rate` pictures a second until the laps are driven, `stop` is set or the time is over.

        `on_lap` is told the lap's number, its seconds and the interventions so far; `on_moment` is called per picture.
        """
        due = begin = time.monotonic()
        while not stop.is_set() and not self._count.arrived and time.monotonic() - begin < seconds:
            laps = len(self._count.lap_ends)
            self.moment(time.monotonic())
            if len(self._count.lap_ends) > laps:
                on_lap(laps + 1, self._lap_seconds()[-1], len(self._count.put_back))
            on_moment()
            due = max(due + 1 / rate, time.monotonic())
            stop.wait(due - time.monotonic())
        return self.summary(time.monotonic())

    def moment(self, now: float) -> None:
        """Takes one picture, and counts."""
        state, count = self.state, self._count
        self._show(self._look(state)[..., :3], now)
        count.pictures += 1
        if abs(state.speed) < ROLLING:
            return
        if count.began is None:
            count.began = now
        s, left = self.path.nearest(state.pose[:2])
        error = math.remainder(state.yaw - float(self.path.poses(np.array([s]))[0, 2]), 2 * math.pi)
        count.lateral.append(abs(left))
        count.heading.append(error)
        length, closed = self.path.length, self.path.closed
        count.travelled += math.remainder(s - self._last, length) if closed else s - self._last
        self._last = s
        if abs(left) > self.drive.intervention or self._touches(footprint(state.pose, self.body)):
            count.put_back.append((state.x, state.y))
            self._put_back(s)
        done = count.travelled >= (len(count.lap_ends) + 1) * length - 1e-6 if closed else s >= length - 0.02
        if done:
            count.lap_ends.append(now)
            count.arrived = not closed or len(count.lap_ends) >= self.drive.laps

    def _put_back(self, s: float) -> None:
        x, y, yaw = self.path.poses(np.array([s]))[0]
        with self._lock:
            self._state = replace(self._state, x=float(x), y=float(y), yaw=float(yaw))

    def _lap_seconds(self) -> list[float]:
        starts = [self._count.began or 0.0, *self._count.lap_ends]
        return [round(end - start, 3) for start, end in zip(starts, self._count.lap_ends)]

    def summary(self, now: float) -> Summary:
        """Returns what happened until now."""
        count = self._count
        return Summary(
            laps=len(count.lap_ends),
            seconds=0.0 if count.began is None else round(now - count.began, 3),
            lap_seconds=self._lap_seconds(),
            distance=round(count.travelled, 3),
            interventions=len(count.put_back),
            put_back=[(round(x, 3), round(y, 3)) for x, y in count.put_back],
            position_rmse=_root_mean_square(count.lateral),
            yaw_rmse=_root_mean_square([math.degrees(error) for error in count.heading]),
            pictures=count.pictures,
        )


def _root_mean_square(values: list[float]) -> float | None:
    return round(math.sqrt(sum(value * value for value in values) / len(values)), 5) if values else None


def rolled(state: CarState, way: float, steering: float, speed: float, wheelbase: float) -> CarState:
    """Returns the state after `way` metres at a steering angle; the arc is exact."""
    change = way * math.tan(steering) / wheelbase
    half = change / 2
    chord = way * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    heading = state.yaw + half
    return CarState(
        state.x + chord * math.cos(heading),
        state.y + chord * math.sin(heading),
        math.remainder(state.yaw + change, 2 * math.pi),
        speed,
        steering,
    )


def car_in_town(config: FakeCarConfig, vesc: FakeVesc, stream: PictureStream) -> SimulatedCar:
    """Puts a car into the town behind a data set, where `evaluate_driving.drive_in` would start it, but at rest.

    Raises UserError for a data set without a town, or a trajectory that it does not have.
    """
    survey = load_driven_survey(config)
    path = survey.trajectories.get(config.trajectory)
    if path is None:
        close = nearest(config.trajectory, list(survey.trajectories))
        raise UserError(f"trajectory is {config.trajectory!r}, which {config.dataset} does not have; {close}")
    wheelbase = vesc.motor.car.wheelbase
    body = replace(config.car, wheelbase=wheelbase)
    town = Deployment(town_of(config, survey), config.deployment, config.camera, body, config.seed, origin_of(survey))
    rng = np.random.default_rng([config.seed, round(path.length * 1000)])
    start = disturbed_start(path, config.drive, config.pure_pursuit, rng)
    town.look(start)  # the first look builds what later ones use
    drive = replace(config.drive, laps=config.laps)
    return SimulatedCar(vesc.motor, path, drive, body, wheelbase, start, town.look, town.touches, stream.show)


def fake_vesc_of(config: FakeCarConfig) -> FakeVesc:
    """Starts the motor controller of a config; raises UserError for a car's file that is missing or wrong."""
    car = load_car(FilePath(config.car_file)).actuation
    return FakeVesc(
        car,
        timeout=config.esc_timeout or None,
        timeout_brake_current=config.esc_brake,
        delay=config.delay / 1000,
        drop=config.drop,
        corrupt=config.corrupt,
        seed=config.seed,
        link=FilePath(config.link) if config.link else None,
    )


class Console:
    """Commands that break things on purpose, a line each: a word, and a number where it needs one."""

    def __init__(self, vesc: FakeVesc, stream: PictureStream) -> None:
        self._numbers: Mapping[str, tuple[float, float, Callable[[float], None]]] = {
            "drop": (0, 1, lambda share: setattr(vesc, "drop", share)),
            "corrupt": (0, 1, lambda share: setattr(vesc, "corrupt", share)),
            "delay": (0, 10_000, lambda milliseconds: setattr(vesc, "delay", milliseconds / 1000)),
            "fault": (0, 255, lambda code: setattr(vesc, "fault", int(code))),
            "voltage": (0, 100, lambda volts: setattr(vesc, "voltage", volts)),
            "temperature": (-40, 150, lambda celsius: setattr(vesc, "temperature", celsius)),
            "runaway": (-50_000, 50_000, lambda erpm: setattr(vesc.motor, "runaway_erpm", erpm or None)),
            "kill_switch": (0, 1, lambda on: setattr(vesc.motor, "kill_switch", on != 0)),
        }
        self._words: Mapping[str, Callable[[], None]] = {
            "stall": vesc.stall_reads,
            "silent": lambda: setattr(vesc, "mode", "silent"),
            "answer": vesc.answer,
            "disconnect": vesc.disconnect,
            "reconnect": vesc.reconnect,
            "freeze": lambda: stream.freeze("still"),
            "repeat": lambda: stream.freeze("repeat"),
            "unplug_camera": stream.unplug,
            "resume_camera": stream.resume,
        }

    def obey(self, line: str) -> str:
        """Does what a line says; returns what to print."""
        word, *rest = line.split() or [""]
        if word in self._words and not rest:
            self._words[word]()
            return f"{word}: done"
        if word in self._numbers:
            low, high, set_to = self._numbers[word]
            try:
                value = float(rest[0]) if len(rest) == 1 else math.nan
            except ValueError:
                value = math.nan
            if not low <= value <= high:
                return f"{word}: give one number from {low:g} to {high:g}"
            set_to(value)
            return f"{word} {value:g}: done"
        return "commands: " + ", ".join([*self._words, *(f"{word} NUMBER" for word in self._numbers), "help"])


class Lines:
    """Whole lines from a file descriptor, as they come and without waiting; none from one that is closed or ended."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._open, self._rest = descriptor, True, b""

    def new(self) -> list[str]:
        """Returns the lines that are there now."""
        while self._open and self._ready():
            try:
                data = os.read(self._descriptor, 4096)
            except OSError:
                data = b""
            self._open = bool(data)
            self._rest += data
        *lines, self._rest = self._rest.split(b"\n")
        return [text for line in lines if (text := line.decode(errors="replace").strip())]

    def _ready(self) -> bool:
        try:
            return bool(select.select([self._descriptor], [], [], 0)[0])
        except (OSError, ValueError):  # closed
            self._open = False
            return False
