"""Real photographs: what held-out quality a training of so many seconds reaches, at several picture sizes.

Real cameras change their exposure. What modelling that for every picture could gain is bounded by giving each held-out
photograph the best gain per colour channel, which no model could know without seeing it (`best_exposure_psnr`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from hashnerf.command_line import load_config
from hashnerf.errors import UserError
from hashnerf.figure_style import FULL_WIDTH, SMALL, new_figure, png_bytes, style_chart
from hashnerf.metrics import psnr
from hashnerf.model_files import load_model
from hashnerf.pipeline import run_stage
from hashnerf.posed_images import PosedImages
from hashnerf.report_tables import Table
from hashnerf.results_page import table_lines
from hashnerf.static_scene import CONFIG, FIELD, RESULTS, SCRIPT, StaticConfig, StaticNerf, load_scene
from hashnerf.transforms_json import read_transforms

TARGET_DB = 24.0
WORTH_DB = 0.5
"""Less than this is not worth parameters for every picture: at best it is reached with the answer in hand."""


@dataclass(frozen=True)
class PhotographStudy:
    """Which photographs, sizes and lengths."""

    data: str = ""
    """Folder of the photographs with their transforms.json."""
    scene: str = "configs/static/caliterra.yaml"
    """Config file of the scene, under what is varied."""
    runs: str = "runs/photographs"
    """Folder of the runs; finished ones are not repeated."""
    sizes: tuple[int, ...] = (250, 500)
    """Widths to which pictures are reduced."""
    steps: tuple[int, ...] = (100, 200, 400, 800, 1600)
    """Lengths of the trainings, each with its own schedule."""
    threads: int = 2
    """Processor threads."""
    page: str = "docs/results/photographs.md"
    """The page to be written, with a chart of the same name."""

    def __post_init__(self) -> None:
        if not self.data:
            raise UserError("data is empty; give the folder of the photographs with their transforms.json")
        if not self.sizes or not self.steps:
            raise UserError("sizes and steps must hold at least one number each")


@dataclass(frozen=True)
class Point:
    """One training."""

    size: int
    steps: int
    seconds: float
    memory_mb: float
    psnr_db: float
    nothing_db: float
    """Of one colour for all."""
    exposure_db: float
    """With the best gain for each held-out photograph."""
    capacity: str
    """Levels, finest resolution and entries of the field."""


def run_study(config: PhotographStudy) -> list[Point]:
    """Trains at every size and length; returns what each cost and reached."""
    folder, points = Path(config.runs), []
    for size in config.sizes:
        for steps in config.steps:
            name = f"{size}px_{steps}"
            own = ["--dataset", config.data, "--runs", config.runs, "--name", name, "--image_size", str(size)]
            limits = ["--steps", str(steps), "--threads", str(config.threads)]
            run_stage(f"{size} px, {steps} steps", [SCRIPT, "--config", config.scene, *own, *limits], folder)
            points.append(read_point(folder / name))
    return points


def read_point(folder: Path) -> Point:
    """Reads what a run of the training script left, and renders its held-out pictures once more."""
    config = load_config(StaticConfig, folder / CONFIG)
    field = config.field
    results = read_transforms(folder / RESULTS)
    data = load_scene(config)
    nerf, cost = load_model(folder / FIELD, lambda _: StaticNerf(config, data.scene_box), SCRIPT)
    return Point(
        data.cameras.width,
        config.steps,
        cost["seconds"],
        cost["peak_memory_mb"],
        results["psnr_db"],
        results["psnr_one_colour_db"],
        best_exposure_psnr(nerf.picture, data.split("test")),
        f"{field.levels} levels to {field.finest_resolution} cells, 2^{field.log2_table_size} entries",
    )


@torch.no_grad()
def best_exposure_psnr(picture: Callable[[PosedImages, int], Tensor], test: PosedImages) -> float:
    """Returns the mean PSNR (dB) of renderings after the least-squares gain per channel to each held-out picture.

    `picture` renders [h, w, 3] what a camera of a data set sees.
    """
    values = []
    for index, photograph in enumerate(test.images):
        seen, true = picture(test, index), photograph.float() / 255
        gain = (seen * true).sum(dim=(0, 1)) / seen.square().sum(dim=(0, 1)).clamp(min=1e-12)
        values.append(psnr(seen * gain, true))
    return float(np.mean(values))


def study_table(points: list[Point]) -> Table:
    """Returns one row a training."""
    head = ("width", "steps", "training", "memory", "held out", "one colour", "best exposure adds")
    rows = tuple(
        (
            f"{p.size} px",
            f"{p.steps}",
            f"{p.seconds:.0f} s",
            f"{p.memory_mb:.0f} MB",
            f"{p.psnr_db:.2f} dB",
            f"{p.nothing_db:.2f} dB",
            f"{p.exposure_db - p.psnr_db:+.2f} dB",
        )
        for p in points
    )
    return Table(head, rows)


def study_chart(points: list[Point]) -> Figure:
    """Held-out PSNR against seconds of training, one line a size."""
    figure = new_figure(FULL_WIDTH * 0.6, 3.2)
    axes = figure.subplots()
    for size in dict.fromkeys(point.size for point in points):
        own = sorted((point for point in points if point.size == size), key=lambda point: point.seconds)
        axes.plot([p.seconds for p in own], [p.psnr_db for p in own], "o-", label=f"{size} px")
    axes.axhline(TARGET_DB, color="black", linewidth=0.8, linestyle=":")
    axes.set_xscale("log")
    style_chart(axes, "", "training (s)", "held-out PSNR (dB)")
    axes.legend(fontsize=SMALL, frameon=False)
    return figure


def exposure_words(points: list[Point]) -> str:
    """Says whether modelling the exposure of every picture can pay."""
    most = max(point.exposure_db - point.psnr_db for point in points)
    said = f"The best gain for each held-out photograph and channel, found with it in hand, adds {most:.2f} dB"
    if most < WORTH_DB:
        return f"{said} at most: exposure is not modelled, as views that were not seen could not gain even that."
    return f"{said} at most: modelling the exposure of every picture may pay."


def write_study(points: list[Point], config: PhotographStudy, about: str) -> None:
    """Writes the page and its chart; `about` says what produced them."""
    page = Path(config.page)
    page.parent.mkdir(parents=True, exist_ok=True)
    chart = page.with_suffix(".png")
    chart.write_bytes(png_bytes(study_chart(points)))
    capacities: Mapping[int, str] = {point.size: point.capacity for point in points}
    lines = ["# Real photographs: quality against seconds", "", about, "", *table_lines(study_table(points)), ""]
    for size, capacity in capacities.items():
        own = [point for point in points if point.size == size]
        able = [point.seconds for point in own if point.psnr_db >= TARGET_DB]
        first = f"reaches {TARGET_DB:g} dB in {min(able):.0f} s" if able else f"does not reach {TARGET_DB:g} dB"
        lines += [f"* {size} px {first}; {capacity}."]
    lines += ["", exposure_words(points), "", f"![PSNR against seconds]({chart.name})"]
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")
