"""What the road prior is worth: fields with parts of it, several seeds, against fields without (Fig. 5, with numbers).

Fields with the same seed and the same start are compared in pairs: their pictures are drawn alike. Intervals are those
of Student's t for the mean difference; one that excludes 0 is significant.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from aerial2ground.road_prior import VARIANTS
from hashnerf.errors import UserError
from hashnerf.results_page import markdown_table

STARTS = {"fog": "false", "opaque ground": "true"}
FIGURES = {
    "hidden_road_psnr_db": "road hidden from above, dB",
    "road_psnr_db": "all road, dB",
    "foreground_psnr_db": "foreground, dB",
    "ssim": "SSIM",
    "road_depth_rmse_m": "road depth within 2 m, m",
}
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Trial:
    """One field of the study."""

    start: str
    variant: str
    seed: int

    @property
    def name(self) -> str:
        """The folder of its run below the study's."""
        return f"{self.start.replace(' ', '_')}_{self.variant}_{self.seed}"

    @property
    def options(self) -> tuple[str, ...]:
        """What tells its training from the others', as options of the scripts."""
        return ("--seed", str(self.seed), "--reconstruction.opaque_start", STARTS[self.start], *VARIANTS[self.variant])


def trials(seeds: int) -> list[Trial]:
    """Returns all fields of a study; raises UserError for fewer than two seeds, which give no interval."""
    if seeds < 2:
        raise UserError(f"seeds is {seeds}; give at least 2, one has no interval")
    return [Trial(start, variant, seed) for seed in range(seeds) for start in STARTS for variant in VARIANTS]


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Returns the mean and half the width of its 95 % interval."""
    half = student.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
    return float(np.mean(values)), float(half)


def read_figures(folder: Path, study: Sequence[Trial]) -> dict[Trial, dict[str, float]]:
    """Returns what was measured of each field; raises UserError for one that was not."""
    found = {}
    for trial in study:
        path = folder / trial.name / "reconstruction.json"
        if not path.is_file():
            raise UserError(f"{path}: was not measured; run scripts/study_road_prior.py again")
        ground = json.loads(path.read_text(encoding="utf-8")).get("ground")
        if ground is None or ground["hidden_road_psnr_db"] is None:
            raise UserError(f"{path}: no road is hidden from above in this data set; make one with an avenue")
        found[trial] = ground
    return found


def study_tables(figures: dict[Trial, dict[str, float]]) -> str:
    """Returns Markdown: means per variant and start, and gains over no prior with their intervals."""
    seeds = sorted({trial.seed for trial in figures})
    head = ["start", "prior", *FIGURES.values()]
    means, gains = [head], [head]
    for start in STARTS:
        for variant in VARIANTS:
            rows = [figures[Trial(start, variant, seed)] for seed in seeds]
            plain = [figures[Trial(start, "none", seed)] for seed in seeds]
            label = variant.replace("_", " + ")
            means.append([start, label, *(_shown(*interval([row[key] for row in rows])) for key in FIGURES)])
            if variant != "none":
                pairs = [interval([row[key] - other[key] for row, other in zip(rows, plain)]) for key in FIGURES]
                gains.append([start, label, *(_shown(mean, half, True) for mean, half in pairs)])
    note = f"Mean of {len(seeds)} seeds ± half the width of its 95 % interval."
    return (
        f"{note}\n\n{markdown_table(means)}\n\nGain over no prior with the same start, in pairs of equal seeds; "
        f"**bold** where the interval excludes 0.\n\n{markdown_table(gains)}\n"
    )


def _shown(mean: float, half: float, sign: bool = False) -> str:
    digits = 2 if max(abs(mean), half) >= 0.3 else 4
    text = f"{mean:+.{digits}f} ± {half:.{digits}f}" if sign else f"{mean:.{digits}f} ± {half:.{digits}f}"
    return f"**{text}**" if sign and abs(mean) > half else text
