"""What derived capacity is worth: scenes from nothing to real photographs, each fitted with the capacity that its
pictures ask for and with the usual fixed one, in equal steps.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from hashnerf.errors import UserError
from hashnerf.pipeline import run_stage
from hashnerf.report_tables import Table
from hashnerf.results_page import table_lines
from hashnerf.static_scene import RESULTS, SCRIPT
from hashnerf.training_run import METRICS
from hashnerf.transforms_json import read_transforms

FIXED = {"field.levels": 16, "field.log2_table_size": 19, "field.finest_resolution": 2048}
"""What Instant-NGP takes for every scene."""
WAYS: Mapping[str, Mapping[str, object]] = {"chosen": {}, "fixed": FIXED}
TIME = "processor_seconds"
"""On a machine that others use, too, the clock on the wall tells little."""
SETTLED = 0.5
"""The last half of the steps, when the occupancy grid knows what is empty."""


@dataclass(frozen=True)
class CapacityStudy:
    """What is fitted, for how long."""

    runs: str = "runs/capacity"
    """Folder of the runs; finished ones are not repeated."""
    steps: int = 800
    """Training steps of every field."""
    seeds: tuple[int, ...] = (0, 1)
    """Seeds of every field: PSNR, time and memory are means over them, as single ones differ by up to 1.3 dB."""
    threads: int = 1
    """Processor threads."""
    photographs: str = ""
    """Folder of the photographs of odm_data_caliterra (CC0); empty leaves that scene out."""
    page: str = "docs/results/capacity.md"
    """The page to be written."""

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise UserError(f"steps is {self.steps}; give at least 1")
        if not self.seeds:
            raise UserError("seeds is empty; give one or more")


@dataclass(frozen=True)
class Scene:
    """A data set, and how it comes about."""

    folder: str
    """Where it lies, or is to be made."""
    made_by: tuple[str, ...] = ()
    """Options of scripts/make_dataset.py; none for what cannot be made."""
    options: tuple[str, ...] = ()
    """Further options of the training."""


EXACT = ("--mini_city.survey.position_noise", "0", "--mini_city.survey.angle_noise", "0")
SCENES: Mapping[str, Scene] = {
    "empty sky": Scene("data/empty", ("--scenario", "one_box", "--one_box.boxes", "0")),
    "one box": Scene("data/one_box", ("--scenario", "one_box")),
    "intersection, one state": Scene("data/intersection", ("--config", "configs/worlds/intersection.yaml")),
    "mini-city, exact poses": Scene("data/mini_city_exact", ("--config", "configs/worlds/mini_city.yaml", *EXACT)),
}


@dataclass(frozen=True)
class Fit:
    """One field: what it was given, what it cost and what it is worth."""

    seconds: float
    """Of processor, as are those of a step."""
    memory_mb: float
    psnr_db: float
    field: Mapping[str, int]
    step_ms: float
    """Of the last half of the steps, the median."""
    samples: int
    """Of a step in the last half, the median."""
    spread_db: float = 0.0
    """From the lowest to the highest PSNR of the seeds."""


def scenes_of(config: CapacityStudy) -> dict[str, Scene]:
    """Returns the scenes by name."""
    scenes = dict(SCENES)
    if config.photographs:
        options = ("--config", "configs/static/caliterra.yaml")
        scenes["photographs, 250 px"] = Scene(config.photographs, options=options)
    return scenes


def run_study(config: CapacityStudy) -> dict[str, dict[str, Fit]]:
    """Makes what data sets are missing and fits every scene both ways; returns scene -> way -> fit."""
    folder, found = Path(config.runs), {}
    for number, (name, scene) in enumerate(scenes_of(config).items()):
        if scene.made_by:
            command = ["scripts/make_dataset.py", *scene.made_by, "--out", scene.folder]
            run_stage(f"pictures of {name}", command, folder)
        found[name] = {}
        for way, settings in WAYS.items():
            options = [part for key, value in settings.items() for part in (f"--{key}", str(value))]
            fits = []
            for seed in config.seeds:
                run = f"scene_{number}_{way}_{config.steps}_{seed}"
                common = ["--dataset", scene.folder, "--runs", config.runs, "--name", run, "--seed", str(seed)]
                limits = ["--steps", str(config.steps), "--threads", str(config.threads)]
                run_stage(f"{name}, {way}, seed {seed}", [SCRIPT, *scene.options, *common, *limits, *options], folder)
                fits.append(read_fit(folder / run, config.steps))
            found[name][way] = mean_fit(fits)
    return found


def mean_fit(fits: Sequence[Fit]) -> Fit:
    """Returns the means over seeds, with the capacity of the first: it depends on the pictures alone."""
    psnr = [fit.psnr_db for fit in fits]
    return Fit(
        float(np.mean([fit.seconds for fit in fits])),
        float(np.mean([fit.memory_mb for fit in fits])),
        float(np.mean(psnr)),
        fits[0].field,
        float(np.mean([fit.step_ms for fit in fits])),
        max(fit.samples for fit in fits),
        max(psnr) - min(psnr),
    )


def read_fit(folder: Path, steps: int) -> Fit:
    """Reads what a run of the training script left."""
    results = read_transforms(folder / RESULTS)
    lines = [json.loads(line) for line in (folder / "field" / METRICS).read_text(encoding="utf-8").splitlines()]
    late = [line for line in lines if line["step"] >= SETTLED * steps] or lines
    pace = [1000 * (after[TIME] - before[TIME]) / (after["step"] - before["step"]) for before, after in pairwise(late)]
    step_ms = float(np.median(pace)) if pace else float("nan")
    samples = int(np.median([line["samples"] for line in late]))
    taken = lines[-1][TIME] * steps / (lines[-1]["step"] + 1)  # the last steps have no line
    return Fit(taken, results["peak_memory_mb"], results["psnr_db"], results["field"], step_ms, samples)


def study_table(found: Mapping[str, Mapping[str, Fit]]) -> Table:
    """Returns one row a scene: what was chosen, and both fits side by side."""
    rows = []
    for name, fits in found.items():
        chosen, fixed = fits["chosen"], fits["fixed"]
        field = chosen.field
        capacity = f"{field['levels']} x 2^{field['log2_table_size']}, {field['finest_resolution']} cells"
        gain, share = chosen.psnr_db - fixed.psnr_db, chosen.seconds / fixed.seconds
        rows.append(
            (
                name,
                capacity,
                f"{chosen.psnr_db:.2f} dB ({chosen.spread_db:.2f})",
                f"{fixed.psnr_db:.2f} dB ({fixed.spread_db:.2f})",
                f"{gain:+.2f} dB ({'met' if gain >= -0.2 else '**missed**'})",
                f"{chosen.seconds:.0f} s",
                f"{fixed.seconds:.0f} s",
                f"{share:.2f} ({'met' if share <= 0.5 else '**missed**'})",
                f"{chosen.step_ms:.1f} ms, {chosen.samples} samples",
                f"{chosen.memory_mb:.0f}, {fixed.memory_mb:.0f} MB",
            )
        )
    head = (
        "scene", "chosen: levels x entries", "PSNR, chosen", "fixed", "difference (target ≥ −0.2)",
        "time, chosen", "fixed", "share (target ≤ 0.5)", "chosen, late step", "memory, chosen and fixed",
    )  # fmt: skip
    return Table(head, tuple(rows))


def empty_share(found: Mapping[str, Mapping[str, Fit]]) -> float:
    """Returns what a late step in the empty sky costs beside one in the mini-city, both with chosen capacity."""
    empty, full = (found[name]["chosen"].step_ms for name in ("empty sky", "mini-city, exact poses"))
    return empty / full


def write_study(found: Mapping[str, Mapping[str, Fit]], config: CapacityStudy, about: str) -> None:
    """Writes the page; `about` says what produced it."""
    share, samples = empty_share(found), found["empty sky"]["chosen"].samples
    verdict = "met" if share <= 0.05 and samples == 0 else "**missed**"
    lines = [
        "# Only what the scene requires",
        "",
        about,
        "",
        f"Every scene is fitted in {config.steps} steps twice: with the capacity that `hashnerf/capacity.py` derives "
        "from the pictures, and with 16 levels of 2^19 entries up to 2,048 cells (Instant-NGP's for every scene); all "
        "else is equal, and derived, too. PSNR is the mean over held-out pictures and "
        f"{len(config.seeds)} seeds (in brackets: from the lowest to the highest), seconds are the processor's in "
        "training.",
        "",
        *table_lines(study_table(found)),
        "",
        f"A late step in the empty sky takes {100 * share:.1f} % of one in the mini-city and {samples} samples "
        f"({verdict}, target at most 5 %, and none). Every sixteenth step samples everywhere, in search of what may "
        "have appeared; its time is in the share.",
    ]
    page = Path(config.page)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text("\n".join(lines) + "\n", encoding="utf-8")
