"""The mini-city: a town at 1/10 scale like the one of "Learning autonomous driving from aerial imagery" (Fig. 3, 4, 6).

Roads are fixed (`worlds.mini_city_roads`); `layout` chooses where houses, trees and cars stand, the seed varies sizes
and colours. The car drives in the city as the drone saw it or, for deployment, in one that has changed since: another
sun, and small things that were moved.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from worlds.checks import check_between
from worlds.drone_survey import SurveyConfig, survey_rig
from worlds.meshes import Material, Mesh, blob, block, cylinder, hexahedron, merge, quad
from worlds.mini_city_roads import AREA, LANE, LOOP, on_road, road_bodies, road_network, trajectories
from worlds.polylines import arc_lengths, beside, resampled
from worlds.scene import State, World
from worlds.shading import Light
from worlds.street import FOLIAGE, GRASS, TRUNK, building, hedge, tree
from worlds.vehicles import sedan

SCALE = 0.1
FLOOR = Material((0.30, 0.30, 0.31), grain=0.05)
METAL = Material((0.20, 0.21, 0.22))
LAMP = Material((0.80, 0.78, 0.65))
ROOFS = ((0.30, 0.08, 0.05), (0.16, 0.15, 0.17), (0.24, 0.13, 0.07))
WALLS = ((0.62, 0.55, 0.42), (0.55, 0.30, 0.22), (0.60, 0.60, 0.58), (0.42, 0.48, 0.56), (0.66, 0.60, 0.30))
PAINTS = ((0.50, 0.04, 0.03), (0.04, 0.10, 0.45), (0.55, 0.55, 0.56), (0.06, 0.25, 0.10), (0.60, 0.45, 0.05))
LOTS = tuple((x, y) for x in (1.56, 2.16, 3.84, 4.44) for y in (1.58, 2.19, 2.81, 3.42))
LAYOUTS = 3


@dataclass(frozen=True)
class MiniCityConfig:
    """The town, and how it was surveyed."""

    layout: int = 0
    """Which of the arrangements of houses, trees and cars: 0, 1 or 2."""
    light: Light = field(default_factory=Light)
    """Where the sun stands."""
    avenue: int = 0
    """Trees whose wide crowns hang over the road, so that little of it is seen from above."""
    displacement: float = 0.0
    """Trees, lamp posts and parked cars stand up to this far from their places, metres."""
    survey: SurveyConfig = field(default_factory=SurveyConfig)
    """The drone's pictures."""

    def __post_init__(self) -> None:
        check_between("mini_city.layout", self.layout, 0, LAYOUTS - 1)
        check_between("mini_city.avenue", self.avenue, 0, 60)
        check_between("mini_city.displacement", self.displacement, 0.0, 0.1)


def build_mini_city(config: MiniCityConfig, seed: int) -> World:
    """The town that (config, seed) fixes; one state, nothing moves."""
    box = np.array([[AREA[0] - 0.4, AREA[1] - 0.4, -0.06], [AREA[2] + 0.4, AREA[3] + 0.4, 0.95]])
    return World(
        scenario="mini_city",
        seed=seed,
        config=config,
        branches=("city",),
        static=tuple(_bodies(config, seed)),
        actors={},
        states=(State(0, 0, False, {}),),
        light=config.light,
        scene_box=box,
        rig=survey_rig(config.survey, np.random.default_rng([seed, 77])),
        extras={
            "road_network": road_network(),
            "trajectories": {name: resampled(line, 0.05).round(4).tolist() for name, line in trajectories().items()},
        },
    )


def _bodies(config: MiniCityConfig, seed: int) -> list[tuple[str, Mesh]]:
    rng = np.random.default_rng([seed, config.layout])
    moved = np.random.default_rng([seed, config.layout, 1])

    def shift() -> np.ndarray:
        return moved.uniform(-1.0, 1.0, 2) * config.displacement

    x0, y0, x1, y1 = AREA
    bodies = [
        ("floor", block((x0 - 4.0, y0 - 4.0, -0.2), (x1 + 4.0, y1 + 4.0, -0.03), FLOOR)),
        ("lawn", block((x0 - 0.2, y0 - 0.2, -0.1), (x1 + 0.2, y1 + 0.2, -0.002), GRASS)),
        *road_bodies(),
    ]
    for number, (x, y) in enumerate(LOTS):
        kind = rng.choice(("house", "house", "trees", "hedge"))
        if kind == "house":
            bodies.append((f"house_{number}", house(x, y, rng)))
        elif kind == "trees":
            for part in range(2):
                dx, dy = rng.uniform(-0.15, 0.15, 2) + shift()
                bodies.append(
                    (f"tree_{number}_{part}", _scaled(tree(0.0, 0.0, rng.uniform(3.5, 6.0), rng), x + dx, y + dy))
                )
        else:
            width = 10 * rng.uniform(0.3, 0.5)
            bodies.append((f"hedge_{number}", _scaled(hedge((-width / 2, -0.4, width / 2, 0.4), 1.2), x, y)))
    bodies += _roadside(rng, shift)
    bodies += _avenue(config.avenue, np.random.default_rng([seed, config.layout, 2]))
    return bodies


def house(x: float, y: float, rng: np.random.Generator) -> Mesh:
    """A small house with windows, a door and a gabled roof around (x, y)."""
    length, width, height = rng.uniform(4.0, 5.0), rng.uniform(3.4, 4.6), rng.uniform(3.0, 5.0)
    area = (-length / 2, -width / 2, length / 2, width / 2)
    walls = building(area, height, WALLS[rng.integers(len(WALLS))])
    roof = Material(ROOFS[rng.integers(len(ROOFS))], grain=0.1)
    over, rise = 0.3, rng.uniform(1.2, 2.0)
    low = [(area[0] - over, area[1] - over), (area[2] + over, area[1] - over),
           (area[2] + over, area[3] + over), (area[0] - over, area[3] + over)]  # fmt: skip
    ridge = [(area[0] - over, -0.02), (area[2] + over, -0.02), (area[2] + over, 0.02), (area[0] - over, 0.02)]
    top = hexahedron([(*p, height) for p in low], [(*p, height + rise) for p in ridge], roof)
    turn = float(rng.integers(4)) * math.pi / 2
    return _scaled(merge([walls, top]), x, y, turn)


def lamp_post(x: float, y: float) -> Mesh:
    """A lamp on a pole."""
    pole = cylinder((0.0, 0.0, 2.0), 0.09, 4.0, METAL, sides=8)
    return _scaled(merge([pole, block((-0.2, -0.2, 4.0), (0.2, 0.2, 4.4), LAMP)]), x, y)


def _roadside(rng: np.random.Generator, shift) -> list[tuple[str, Mesh]]:
    """Lamp posts, trees and parked cars along the outside of the loop, and a sign board at every corner."""
    bodies: list[tuple[str, Mesh]] = []
    x0, y0, x1, y1 = AREA
    rim = [(x, y, 0.0) for x in np.arange(0.9, 5.4, 0.75) for y in (y0 + 0.16, y1 - 0.16)]
    rim += [(x, y, math.pi / 2) for y in np.arange(1.0, 4.2, 0.75) for x in (x0 + 0.16, x1 - 0.16)]
    for number, (x, y, yaw) in enumerate(rim):
        kind = rng.choice(("lamp", "tree", "car", "none"), p=(0.3, 0.3, 0.25, 0.15))
        dx, dy = shift()
        if kind == "lamp":
            bodies.append((f"lamp_{number}", lamp_post(x + dx, y + dy)))
        elif kind == "tree":
            bodies.append((f"tree_rim_{number}", _scaled(tree(0.0, 0.0, rng.uniform(3.0, 5.0), rng), x + dx, y + dy)))
        elif kind == "car":
            paint = PAINTS[rng.integers(len(PAINTS))]
            bodies.append((f"car_{number}", _scaled(sedan((4.2, 1.7, 1.4), paint), x + dx, y + dy, yaw)))
    for number, (x, y) in enumerate([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]):
        colour = Material(PAINTS[(number + int(rng.integers(len(PAINTS)))) % len(PAINTS)])
        bodies.append((f"board_{number}", _board(x, y, colour)))
    return bodies


def _avenue(count: int, rng: np.random.Generator) -> list[tuple[str, Mesh]]:
    """Trees along the loop, on alternate sides: a slender trunk beside the road and a flat crown over its middle."""
    place = arc_lengths(LOOP)
    bodies = []
    for number, s in enumerate((np.arange(count) + 0.5) / max(count, 1) * place[-1]):
        side = 1 if number % 2 else -1
        x, y = (np.interp(s, place, beside(LOOP, side * (LANE + 0.12))[:, axis]) for axis in range(2))
        mx, my = (np.interp(s, place, LOOP[:, axis]) for axis in range(2))
        if on_road(np.array([(x, y)]), 0.05)[0]:
            continue
        trunk = cylinder((x, y, 0.24), 0.018, 0.48, TRUNK, sides=8)
        crown = blob(((x + mx) / 2, (y + my) / 2, 0.52), (0.38, 0.38, 0.10), FOLIAGE, rng)
        bodies.append((f"tree_avenue_{number}", merge([trunk, crown])))
    return bodies


def _board(x: float, y: float, material: Material) -> Mesh:
    """A coloured board that faces the middle of the town."""
    yaw = math.atan2((AREA[1] + AREA[3]) / 2 - y, (AREA[0] + AREA[2]) / 2 - x)
    front = quad([(0.02, 0.25, 0.1), (0.02, -0.25, 0.1), (0.02, -0.25, 0.45), (0.02, 0.25, 0.45)][::-1], material)
    back = block((-0.02, -0.27, 0.0), (0.015, 0.27, 0.47), METAL)
    return merge([back, front]).placed(x, y, 0.0, yaw)


def _scaled(mesh: Mesh, x: float, y: float, yaw: float = 0.0) -> Mesh:
    """A full-size mesh at the town's scale, turned and then moved."""
    small = Mesh((mesh.vertices * SCALE).astype(np.float32), mesh.faces, mesh.colour, mesh.grain, mesh.gloss)
    return small.placed(x, y, 0.0, yaw)
