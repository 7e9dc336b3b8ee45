"""Decisions all along the ego's approach: single pictures every few centimetres, where no camera of the data stands.

The planning table of the report judges a dozen or two pictures of the data set, most of which were trained on. Here the
embedded world shows what the ego's own camera would see in every state of the data from every place before the stop
line: hundreds of new pictures, whose equality tells as exactly as in the data what each of them allows to know.
"""

import torch

from carff.decisions import decide_from_pictures
from carff.driving import Drive, DrivingConfig, Setup
from carff.ego_pictures import Look
from carff.model import CarffModel
from carff.picture_kinds import picture_kinds
from carff.planning_metrics import ApproachPoint
from carff.states import ambiguous_groups
from worlds.scene import World

SPACING = 0.2  # metres


def decide_along_approach(
    model: CarffModel, world: World, look: Look, n: int, config: DrivingConfig, seed: int
) -> list[ApproachPoint]:
    """Returns decisions by the planner's rule at every place and in every state that goes on, from `n` futures each."""
    states, places = model.scene.states, approach_places(world, config)
    pictures = look([standing(world, state, place) for state in states for place in places])
    rows = torch.arange(len(pictures)).reshape(len(states), len(places))
    groups = ambiguous_groups(pictures, rows)
    hazard, successor = model.scene.known_hazard(), model.scene.successor
    state = torch.arange(len(states)).repeat_interleave(len(places))
    kinds = picture_kinds(state, (groups * len(places) + torch.arange(len(places))).flatten(), hazard, successor)
    asked = (successor[state] >= 0).nonzero()[:, 0]
    generator = torch.Generator().manual_seed(seed)
    decisions = decide_from_pictures(model, pictures[asked], model.config.planner, n, generator)
    return [
        ApproachPoint(
            *states[int(state[row])],
            to_line=round(world.traffic.stop - places[row % len(places)], 3),
            kind=kinds.name(row),
            hazard_share=(one.hazards + one.unknown) / one.samples,
            go=one.go,
        )
        for row, one in zip(asked.tolist(), decisions)
    ]


def approach_places(world: World, config: DrivingConfig) -> list[float]:
    """Returns arc lengths of the ego from the stop line back to the farthest start that driving draws."""
    branch, step = min((branch, step) for branch, step, name in world.traffic.starts if name == "ego")
    first = world.traffic.starts[branch, step, "ego"] - config.start_jitter
    count = int((world.traffic.stop - first) / SPACING) + 1
    return [world.traffic.stop - SPACING * number for number in range(max(count, 1))]


def standing(world: World, state: tuple[int, int], place: float) -> Drive:
    """Returns the moment in which a state's actors stand where the data has them, and the ego at `place`."""
    starts = {name: s for (*own, name), s in world.traffic.starts.items() if tuple(own) == state}
    return Drive(Setup(state[0], starts, dict.fromkeys(starts, 0.0)), 0.0, place, 0.0)
