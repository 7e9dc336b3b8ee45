"""The fit when numbers go wrong for good: it stops in words, and the checkpoints hold what was good."""

import dataclasses
import math

import pytest
import torch

from hashnerf.checkpoints import load_checkpoint
from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.fit import FieldFit, FitConfig, fit_field
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.training_run import TrainingRun
from tests.hashnerf.analytic_scene import BOX, Pictures, ring_of_cameras

FIELD = FieldConfig(levels=3, log2_table_size=10, base_resolution=6, finest_resolution=24, hidden_width=16)
BANK = torch.tensor([[-1.0], [1.0]])
FIRST_BAD = 6
# what goes wrong -> what is named, and the step at which training ends: at once, or at the eleventh bad step running
KINDS = {
    "label": ("colour loss", 16),
    "condition": ("colour loss", 16),
    "loss": ("colour loss", 16),
    "gradient of a network": ("gradient", 16),
    "gradient of a pose": ("gradient", 16),
    "ray": ("rays", 6),
}


class Broken:
    """A fit of the analytic scene with one more parameter, a shift of the cameras, that goes wrong from a step on."""

    def __init__(self, kind: str, bad: float):
        torch.manual_seed(0)
        self.kind, self.bad, self.step, self.good_weights = kind, bad, 0, []
        self.pictures = Pictures(ring_of_cameras(3, 16))
        self.shift = torch.nn.Parameter(torch.zeros(3))
        config = FitConfig(rays=64, batch_samples=1024, log_every=50, occupancy_every=4)
        grid = OccupancyGrid(OccupancyConfig(cell=0.5), BOX)
        further = [{"params": [self.shift], "start": 1e-3}]
        self.field = Field(FIELD, BOX, 1)
        self.fit = FieldFit(self.field, grid, config, MarchSettings(candidates=32), 30, further=further)
        watched = {
            "gradient of a network": next(iter(self.field.density_network.parameters())),
            "gradient of a pose": self.shift,
        }
        if kind in watched:
            watched[kind].register_hook(lambda gradient: gradient * bad if self.is_bad() else gradient)
        if kind == "loss":
            whole = self.fit.loss

            def lossy(*arguments):
                loss, squared, samples = whole(*arguments)
                return (loss * bad if self.is_bad() else loss), squared, samples

            self.fit.loss = lossy

    def is_bad(self) -> bool:
        return self.step >= FIRST_BAD

    def weights(self) -> list[torch.Tensor]:
        return [value.detach().clone() for value in (*self.field.parameters(), self.shift)]

    def draw(self, step, count, generator):
        self.step = step
        if step == FIRST_BAD:
            self.good_weights = self.weights()
        batch = self.pictures.draw(step, count, generator)
        rays = dataclasses.replace(batch.rays, origins=batch.rays.origins + self.shift)
        wrong = torch.zeros(len(rays), 1).index_fill_(0, torch.tensor([3]), self.bad if self.is_bad() else 0.0)
        if self.kind == "ray":
            rays = dataclasses.replace(rays, origins=rays.origins + wrong)
        batch = dataclasses.replace(batch, rays=rays)
        if self.kind == "label":
            batch = dataclasses.replace(batch, rgb=batch.rgb + wrong)
        if self.kind == "condition":
            batch = dataclasses.replace(batch, conditions=batch.conditions + wrong[2:4])
        return batch


@pytest.mark.parametrize("kind", KINDS)
def test_k20_what_is_not_finite_ends_the_run_in_words_and_leaves_good_checkpoints(tmp_path, kind, numeric_row):
    term, last = KINDS[kind]
    for bad in (math.nan, math.inf):
        folder, broken = tmp_path / str(bad), Broken(kind, bad)
        with (
            pytest.raises(UserError, match=rf"training broke down at step {last}: .*{term}"),
            TrainingRun(folder, {}, 30, broken.fit.objects, save_every=4) as run,
        ):
            fit_field(broken.fit, broken.draw, lambda step: BANK, run)
        tensors = load_checkpoint(folder / "checkpoints").tensors
        lost = sum(bool(value.isnan().any()) for value in tensors.values() if value.is_floating_point())
        moved = sum(not torch.equal(a, b) for a, b in zip(broken.good_weights, broken.weights()))
        numeric_row("K20", f"{kind} of {bad} from step {FIRST_BAD} on: tensors lost or moved", lost + moved)


def test_k20_the_step_that_is_named_gives_its_batch_again(numeric_row):
    broken = Broken("none", 0.0)
    draws = [broken.draw(16, 64, broken.fit.generator(16)) for _ in range(2)]
    different = int((draws[0].rays.directions != draws[1].rays.directions).any(dim=1).sum())
    numeric_row("K20", "the batch of a named step, drawn again: rays that differ", different)
