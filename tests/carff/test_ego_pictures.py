"""What the ego's camera sees, rendered once."""

from dataclasses import replace

import numpy as np

from carff import ego_pictures as module
from carff.driving import Drive, Setup
from carff.ego_pictures import Camera, remembering
from worlds.dataset import world_description
from worlds.intersection import IntersectionConfig
from worlds.scenarios import build_world

WORLD = build_world(IntersectionConfig(), 0)


def test_the_picture_is_what_stands_before_the_bumper():
    camera = Camera(world_description(WORLD), 32, 32)
    at_the_line = Drive(Setup(1, {"ego": 11.0, "truck": 9.4}, {"ego": 8.0, "truck": 7.4}), 2.0, 28.0, 0.0)
    with_truck = camera.picture(at_the_line)
    empty = camera.picture(replace(at_the_line, setup=Setup(0, {"ego": 11.0}, {"ego": 8.0})))
    assert with_truck.shape == (32, 32, 3) and with_truck.dtype == np.uint8
    assert (with_truck != empty).any() and (camera.picture(at_the_line) == with_truck).all()


def test_no_scene_is_rendered_twice(monkeypatch):
    rendered: list[list[Drive]] = []

    def render(drives: list[Drive]) -> list[np.ndarray]:
        rendered.append(drives)
        return [np.full((2, 2, 3), 10 * drive.time + drive.s, dtype=np.uint8) for drive in drives]

    look = remembering(WORLD, render)
    empty = Drive(Setup(0, {"ego": 11.0}, {"ego": 8.0}), 1.0, 28.0, 0.0)
    truck = Drive(Setup(1, {"ego": 11.0, "truck": 9.0}, {"ego": 8.0, "truck": 7.0}), 1.0, 28.0, 0.0)
    seen = look([empty, truck, empty])
    assert rendered[-1] == [empty, truck] and seen[:, 0, 0, 0].tolist() == [38, 38, 38]
    # Later nothing has changed without the truck; with it everything has. Another place is another picture, too.
    later = [replace(empty, time=2.0), replace(truck, time=2.0), replace(empty, s=27.0)]
    assert look(later)[:, 0, 0, 0].tolist() == [38, 48, 37]
    assert rendered[-1] == later[1:]
    monkeypatch.setattr(module, "MOST_PICTURES", 1)
    look([empty])
    assert rendered[-1] == [empty], "an over-full memory starts anew"
