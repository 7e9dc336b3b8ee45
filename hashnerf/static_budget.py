"""How long a static scene may be trained: the presets' steps, at the pace that this scene has on this machine."""

from collections.abc import Mapping
from dataclasses import replace
from statistics import median
from time import perf_counter

from hashnerf.budget import best_within
from hashnerf.capacity import fitted_to_scene
from hashnerf.command_line import read_yaml
from hashnerf.fit import FieldFit, RayBatch
from hashnerf.picture_rays import PictureRays
from hashnerf.posed_images import PosedImages
from hashnerf.static_scene import FIELD, StaticConfig, StaticNerf, load_scene
from hashnerf.training_run import CONFIG

TRIAL_STEPS, FIRST_STEPS = 40, 8
"""Steps that are timed after some that warm up: two rounds of the occupancy grid's updates are among them."""


def within_seconds(config: StaticConfig, presets: Mapping[str, Mapping], budget: float) -> tuple[StaticConfig, str]:
    """Returns the config with the steps of the best preset whose training fits a budget (s), and why in one line.

    `presets` are settings from the least to the most accurate. A run that was begun keeps its steps: a second choice
    on a busier machine would be another config. Raises UserError where no preset fits.
    """
    begun = config.folder / FIELD / CONFIG
    if begun.is_file() and not config.overwrite:
        steps = read_yaml(begun)["steps"]
        return replace(config, steps=steps), f"{config.folder}: was begun with {steps} steps and keeps them"
    pace = seconds_per_step(config, load_scene(config).split("train"))
    costs = {name: settings["steps"] * pace for name, settings in presets.items()}
    name, reason = best_within(costs, budget, "max_seconds", "s")
    return replace(config, steps=presets[name]["steps"]), reason


def seconds_per_step(config: StaticConfig, train: PosedImages) -> float:
    """Returns the seconds of a training step, from a few on a field that is thrown away."""
    full, _ = fitted_to_scene(config, train.images, train.cameras, train.scene_box)
    nerf, pictures = StaticNerf(full, train.scene_box), PictureRays.of(train)
    fit = FieldFit(nerf.field, nerf.occupancy, full.fit, full.march, TRIAL_STEPS)
    taken = []
    for step in range(FIRST_STEPS + TRIAL_STEPS):
        start = perf_counter()
        if step % full.fit.occupancy_every == 0:
            fit.update_occupancy(None)
        generator = fit.generator(step)
        fit.step(step, RayBatch(*pictures.rays(*pictures.draw(fit.rays_wanted(), generator))), generator)
        taken.append(perf_counter() - start)
    late = taken[FIRST_STEPS:]
    # the updates are few and dear, which a median would forget
    return max(sum(late) / len(late), median(late))
