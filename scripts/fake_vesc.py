"""A simulated car to drive through a serial port and a camera stream: a fake VESC on a pseudo terminal, and the town.

python scripts/fake_vesc.py --config configs/aerial2ground/fast.yaml --trajectory outer_loop --laps 5 --link runs/car
While it runs it takes commands, a line each: `help` lists them.
"""

import dataclasses
import json
import math
import signal
import sys
import threading
from pathlib import Path

from aerial2ground.bridge.fake_car import Console, FakeCarConfig, Lines, car_in_town, fake_vesc_of
from aerial2ground.bridge.picture_stream import PictureStream
from hashnerf.command_line import parse_config, run_main
from hashnerf.transforms_json import write_atomically


def main() -> None:
    """Say where port and camera are, run until the laps are driven or somebody interrupts, and sum up."""
    config = parse_config(FakeCarConfig, description="Simulate a racecar behind a serial port and a camera stream.")
    sys.setswitchinterval(0.0005)  # the motor controller must not wait for the renderer
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with fake_vesc_of(config) as vesc, PictureStream() as stream:
        car = car_in_town(config, vesc, stream)
        print(f"port: {vesc.port}", flush=True)
        print(f"camera: {stream.url}", flush=True)
        # a closed stdin has no number of its own any more: 0 may be the terminal of the fake by now
        console, lines = Console(vesc, stream), Lines(-1 if sys.stdin is None else sys.stdin.fileno())

        def on_moment() -> None:
            for line in lines.new():
                print(console.obey(line), flush=True)

        summary = car.run(config.rate, stop, config.seconds or math.inf, _print_lap, on_moment)
    text = json.dumps(dataclasses.asdict(summary), indent=2)
    if config.out:
        write_atomically(Path(config.out), text.encode())
    print(text)


def _print_lap(lap: int, seconds: float, interventions: int) -> None:
    print(f"lap {lap}: {seconds:.1f} s, {interventions} interventions so far", flush=True)


if __name__ == "__main__":
    run_main(main)
