"""How long a static scene may be trained: the presets' steps, at the pace that this scene has on this machine."""

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

from hashnerf.budget import best_within
from hashnerf.capacity import fitted_to_scene
from hashnerf.posed_images import PosedImages
from hashnerf.static_scene import FIELD, StaticConfig, StaticNerf, batches_of, load_scene, new_fit
from hashnerf.training_run import begun_config

FIRST_STEPS, TRIAL_STEPS = 8, 40
"""Steps that warm up, and steps that are timed after them."""
LATER = 1.4
"""As the air clears rays have fewer samples, and there are more rays to a step: a late step may take this many times
an early one (one box in the air: 1.4, scenes full of surface: less than 1)."""


def within_seconds(config: StaticConfig, presets: Mapping[str, int], budget: float) -> tuple[StaticConfig, str]:
    """Returns the config with the steps of the best preset whose training fits a budget (s), and why in one line.

    `presets` are steps, from the least to the most accurate preset. A run that was begun keeps its steps: a second
    choice on a busier machine would be another config. Raises UserError where no preset fits.
    """
    begun = begun_config(config.folder / FIELD, config.overwrite)
    if begun is not None:
        steps = begun["steps"]
        return replace(config, steps=steps), f"{config.folder}: was begun with {steps} steps and keeps them"
    pace = LATER * seconds_per_step(config, load_scene(config).split("train"))
    costs = {name: steps * pace for name, steps in presets.items()}
    name, reason = best_within(costs, budget, "max_seconds", "s")
    return replace(config, steps=presets[name]), reason


def seconds_per_step(config: StaticConfig, train: PosedImages) -> float:
    """Returns the mean seconds of an early training step, from a few on a field that is thrown away."""
    full, _ = fitted_to_scene(config, train.images, train.cameras, train.scene_box)
    fit, draw_batch = new_fit(full, StaticNerf(full, train.scene_box), TRIAL_STEPS), batches_of(train)
    start = perf_counter()
    for step in range(FIRST_STEPS + TRIAL_STEPS):
        if step == FIRST_STEPS:
            start = perf_counter()
        if step % full.fit.occupancy_every == 0:
            fit.update_occupancy(None)
        generator = fit.generator(step)
        fit.step(step, draw_batch(step, fit.rays_wanted(), generator), generator)
    return (perf_counter() - start) / TRIAL_STEPS
