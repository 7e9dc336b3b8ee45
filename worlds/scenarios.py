"""The scenarios by name, and scenes at arbitrary poses for driving in closed loop."""

import dataclasses
import typing
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from hashnerf.errors import UserError
from worlds.boxes import Pose
from worlds.cube_cylinder import CubeCylinderConfig, build_cube_cylinder
from worlds.intersection import IntersectionConfig, build_intersection
from worlds.mini_city import MiniCityConfig, build_mini_city
from worlds.one_box import OneBoxConfig, build_one_box
from worlds.scene import Scene, World
from worlds.single_scene_intersection import SingleSceneIntersectionConfig, build_single_scene_intersection
from worlds.two_lane_merge import TwoLaneMergeConfig, build_two_lane_merge

ScenarioConfig = (
    MiniCityConfig
    | IntersectionConfig
    | TwoLaneMergeConfig
    | SingleSceneIntersectionConfig
    | CubeCylinderConfig
    | OneBoxConfig
)

_BUILDERS = {
    "intersection": (IntersectionConfig, build_intersection),
    "two_lane_merge": (TwoLaneMergeConfig, build_two_lane_merge),
    "single_scene_intersection": (SingleSceneIntersectionConfig, build_single_scene_intersection),
    "cube_cylinder": (CubeCylinderConfig, build_cube_cylinder),
    "mini_city": (MiniCityConfig, build_mini_city),
    "one_box": (OneBoxConfig, build_one_box),
}
SCENARIOS = tuple(_BUILDERS)


@lru_cache(maxsize=8)
def build_world(config: ScenarioConfig, seed: int) -> World:
    """The world that (config, seed) fixes; its class says which scenario. Built once and kept."""
    builder = next(build for kind, build in _BUILDERS.values() if kind is type(config))
    return builder(config, seed)


def build_scene(config: ScenarioConfig, seed: int, actor_poses: Mapping[str, Pose]) -> Scene:
    """The world's static bodies with actors at any poses; raises UserError for an actor that the scenario lacks."""
    world = build_world(config, seed)
    for name in actor_poses:
        if name not in world.actors:
            known = ", ".join(world.actors)
            raise UserError(f"{world.scenario} has no actor {name!r}; its actors are {known}.")
    return Scene(world, actor_poses)


def world_from_description(description: Mapping[str, Any]) -> World:
    """The world that a data set's `world` entry (scenario, seed, config) describes; UserError where it does not fit."""
    scenario = description.get("scenario")
    if scenario not in _BUILDERS:
        raise UserError(f"world.scenario = {scenario!r} is not known; known: {', '.join(SCENARIOS)}.")
    seed = description.get("seed")
    if not isinstance(seed, int) or seed < 0:
        raise UserError(f"world.seed = {seed!r} must be a whole number from 0.")
    config = _from_plain(_BUILDERS[scenario][0], description.get("config"), "world.config")
    return build_world(config, seed)


def _from_plain(config_class: type, values: Any, where: str) -> Any:
    """A config dataclass from the nested dict that `dataclasses.asdict` makes of it."""
    if not isinstance(values, dict):
        raise UserError(f"{where} = {values!r} must be an object of settings.")
    hints = typing.get_type_hints(config_class)
    for name in values:
        if name not in hints:
            raise UserError(f"{where}.{name} is not a setting of this scenario; make the data set again.")
    out = {}
    for name, value in values.items():
        key = f"{where}.{name}"
        if dataclasses.is_dataclass(hints[name]):
            out[name] = _from_plain(hints[name], value, key)
        elif isinstance(value, (int, float)) and not isinstance(value, bool) and hints[name] is float:
            out[name] = float(value)
        elif isinstance(value, hints[name]) and not isinstance(value, bool):
            out[name] = value
        else:
            raise UserError(f"{key} = {value!r} must be of type {hints[name].__name__}.")
    return config_class(**out)
