"""A radiance field of posed photographs and nothing else: no roads, no latents, no motion.

runs/<name>/{config.yaml, field/, reconstruction.json, held_out.png}. Capacity that the config leaves open (0) is
derived from the pictures (`hashnerf.capacity`) and stored in the run's config.
"""

import json
from dataclasses import dataclass, replace
from dataclasses import field as option
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor, nn

from hashnerf.capacity import with_capacity
from hashnerf.command_line import plain_config, save_config, set_threads
from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.fit import DrawBatch, FieldFit, FitConfig, RayBatch, fit_field
from hashnerf.marching import MarchSettings
from hashnerf.metrics import json_number, psnr
from hashnerf.model_files import load_model, save_model
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.picture_rays import PictureRays
from hashnerf.posed_images import PosedImages, load_posed_images
from hashnerf.random_state import seed_everything
from hashnerf.render import render_images
from hashnerf.training_run import TrainingRun, begun_config, run_folder
from hashnerf.transforms_json import write_atomically
from hashnerf.visible_volume import visible_box

CONFIG, FIELD, RESULTS = "config.yaml", "field", "reconstruction.json"
SHOWN = 3
"""Held-out photographs in the picture."""
SCRIPT = "scripts/train_static_nerf.py"


@dataclass(frozen=True)
class StaticConfig:
    """A radiance field of one data-set folder."""

    name: str = "scene"
    """Name of the run; everything is written to `<runs>/<name>/`."""
    dataset: str = "data/scene"
    """Folder with transforms.json and images."""
    runs: str = "runs"
    """Folder that holds the runs."""
    image_size: int = 0
    """Width to which pictures are reduced; 0 keeps them."""
    branch: int = 0
    """Which of the data set's possible worlds is shown."""
    step: int = 0
    """Which of its moments."""
    test_every: int = 8
    """Every this many-th picture from the first is held out where no frame names a split; 0: none."""
    scene_box: tuple[float, ...] = ()
    """Region with content (x0, y0, z0, x1, y1, z1), metres, in place of the data set's own."""
    seed: int = 0
    """Seed of everything random."""
    threads: int = 0
    """Processor threads; 0 uses all cores."""
    overwrite: bool = False
    """Start a finished run anew."""
    steps: int = 1500
    """Training steps."""
    save_every: int = 500
    """Steps between checkpoints."""
    field: FieldConfig = option(
        default_factory=lambda: FieldConfig(
            levels=0, log2_table_size=0, finest_resolution=0, sky_width=64, mlp_dtype="bfloat16"
        )
    )
    """Capacity of the field."""
    occupancy: OccupancyConfig = option(default_factory=lambda: OccupancyConfig(cell=0.0, decay=0.8))
    """The grid that skips empty space."""
    march: MarchSettings = option(default_factory=lambda: MarchSettings(candidates=0, even_distance=0.0))
    """How rays are sampled."""
    fit: FitConfig = option(
        default_factory=lambda: FitConfig(
            learning_rate=0.05,
            final_share=0.02,
            first_samples_per_opacity=8.0,
            batch_samples=16384,
            opacity_weight=0.001,
            most_rays=4096,
        )
    )
    """Optimiser and batch."""

    def __post_init__(self) -> None:
        for key in ("steps", "save_every"):
            if getattr(self, key) < 1:
                raise UserError(f"{key} is {getattr(self, key)}; give at least 1")
        if len(self.scene_box) not in (0, 6):
            raise UserError(f"scene_box is {list(self.scene_box)}; give x0, y0, z0, x1, y1, z1")
        if self.test_every < 0 or self.test_every == 1:
            raise UserError(f"test_every is {self.test_every}; give 2 or more, or 0 to hold out no picture")

    @property
    def folder(self) -> Path:
        """Where the run lives; raises UserError for a name that is no plain word."""
        return run_folder(Path(self.runs), self.name)


class StaticNerf(nn.Module):
    """A field and its occupancy grid."""

    def __init__(self, config: StaticConfig, scene_box: Float[Tensor, "2 3"]):
        super().__init__()
        self.config = config
        self.field = Field(config.field, scene_box)
        self.occupancy = OccupancyGrid(config.occupancy, scene_box)

    def picture(self, data: PosedImages, index: int) -> Float[Tensor, "h w 3"]:
        """Returns the field as a camera of a data set sees it."""
        seen = render_images(
            data.cameras,
            [index],
            lambda positions, directions, ray: self.field(positions, directions),
            self.occupancy,
            self.config.march,
            self.field.background,
            density_fn=lambda positions, ray: self.field.density(positions)[0],
        )
        return seen.rgb.view(data.images[index].shape)


def load_scene(config: StaticConfig) -> PosedImages:
    """Loads the pictures of one state of a data set; raises UserError where none of them is there to learn from.

    A box that neither the data set nor the config states is trimmed to what the training pictures see.
    """
    set_threads(config.threads)
    seed_everything(config.seed)
    data = load_posed_images(Path(config.dataset), config.image_size or None)
    data = data.select([r for r, f in enumerate(data.frames) if (f.branch, f.step) == (config.branch, config.step)])
    data = data.with_test_every(config.test_every)
    train = data.split("train")
    if not len(train):
        raise UserError(
            f"{config.dataset}: has no training picture of branch {config.branch}, step {config.step}; "
            "give the branch and step of some, or another test_every"
        )
    data = data.with_scene_box(config.scene_box)
    return data if data.box_told else replace(data, scene_box=visible_box(train.cameras, data.scene_box))


def train_static(config: StaticConfig) -> dict:
    """Trains on a data set, or continues, and measures on the pictures held out; returns what it found.

    Writes the run's folder; held_out.png shows photographs above their renderings.
    """
    data = load_scene(config)
    train, test = data.split("train"), data.split("test")
    begun = begun_config(config.folder / FIELD, config.overwrite)
    full = with_capacity(config, begun, train.images, train.cameras, data.scene_box)
    torch.manual_seed(config.seed)
    nerf = StaticNerf(full, data.scene_box)
    fit_static(full, nerf, train)
    save_config(full, config.folder / CONFIG)
    nerf, cost = load_model(config.folder / FIELD, lambda _: nerf, SCRIPT)
    results = {
        "seconds": cost["seconds"],
        "peak_memory_mb": cost["peak_memory_mb"],
        "field": plain_config(full.field),
        "training_pictures": len(train),
        "test_pictures": len(test),
    }
    if len(test):
        # infinite where pictures are of one colour: JSON has no number for that
        results |= {"psnr_db": json_number(held_out_psnr(nerf, test))}
        results |= {"psnr_one_colour_db": json_number(one_colour_psnr(train, test))}
        Image.fromarray(held_out_sheet(nerf, test)).save(config.folder / "held_out.png")
    write_atomically(config.folder / RESULTS, json.dumps(results, indent=1, allow_nan=False).encode())
    return results


def fit_static(config: StaticConfig, nerf: StaticNerf, train: PosedImages) -> None:
    """Trains a field on pictures in the run's folder; averaged weights are saved there."""
    draw_batch = batches_of(train)
    fit = new_fit(config, nerf, config.steps)
    plain = plain_config(config)
    pictures = ("dataset", "image_size", "branch", "step", "test_every", "scene_box")
    record = {name: plain[name] for name in (*pictures, "seed", "steps", "field", "occupancy", "march", "fit")}
    record["box"] = [round(side, 4) for side in train.scene_box.flatten().tolist()]
    folder = config.folder / FIELD
    with TrainingRun(
        folder, record, config.steps, fit.objects, None, config.save_every, overwrite=config.overwrite
    ) as run:
        fit_field(fit, draw_batch, lambda step: None, run)
        with fit.average.applied():
            save_model(folder, nerf, run)


def new_fit(config: StaticConfig, nerf: StaticNerf, steps: int) -> FieldFit:
    """Returns a fit of a field that has not begun."""
    return FieldFit(nerf.field, nerf.occupancy, replace(config.fit, seed=config.seed), config.march, steps)


def batches_of(train: PosedImages) -> DrawBatch:
    """Returns what draws the rays and colours of a step."""
    pictures = PictureRays.of(train)
    return lambda step, count, generator: RayBatch(*pictures.rays(*pictures.draw(count, generator)))


def held_out_psnr(nerf: StaticNerf, test: PosedImages) -> float:
    """Returns the mean PSNR (dB) over pictures that were held out."""
    return float(
        np.mean([psnr(nerf.picture(test, index), test.images[index].float() / 255) for index in range(len(test))])
    )


def one_colour_psnr(train: PosedImages, test: PosedImages) -> float:
    """Returns the mean PSNR (dB) of pictures in the mean colour of the training ones: what knowing nothing gives."""
    colour = train.images.float().mean(dim=(0, 1, 2)) / 255
    pictures = test.images.float() / 255
    return float(np.mean([psnr(colour.expand_as(picture), picture) for picture in pictures]))


def held_out_sheet(nerf: StaticNerf, test: PosedImages) -> np.ndarray:
    """Returns photographs, evenly chosen, above the renderings from their poses."""
    rows = np.unique(np.linspace(0, len(test) - 1, SHOWN).round().astype(int))
    pairs = []
    for row in rows.tolist():
        seen = (nerf.picture(test, row).clamp(0, 1) * 255).round().to(torch.uint8)
        pairs.append(np.concatenate([test.images[row].numpy(), seen.numpy()]))
    return np.concatenate(pairs, axis=1)
