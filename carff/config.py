"""One config for the whole pipeline: every script reads the same file and uses its part of it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from carff.mdn_training import MdnConfig
from carff.nerf import NerfConfig
from carff.pcvae import PcvaeConfig
from carff.planner import PlannerConfig
from carff.probe import ProbeConfig
from hashnerf.errors import UserError
from hashnerf.training_run import run_folder


@dataclass(frozen=True)
class EvaluationConfig:
    """How much is measured for the report."""

    preset: Literal["fast", "balanced", "accurate"] = "fast"
    """Whose targets the report compares with."""
    images: int = 12
    """Pictures per kind (hazard hidden, clear) in the planning trials."""
    trials: int = 30
    """Trials per picture (paper: 30 in all, of one picture)."""
    curve_samples: int = 50
    """Largest number of samples in the accuracy and recall curves."""
    episodes: int = 100
    """Closed-loop episodes per policy."""

    def __post_init__(self):
        for key in ("images", "trials", "curve_samples", "episodes"):
            if getattr(self, key) < 1:
                raise UserError(f"evaluation.{key} is {getattr(self, key)}; give at least 1")


@dataclass(frozen=True)
class CarffConfig:
    """The CARFF pipeline on one data-set folder."""

    name: str = "carff"
    """Name of the run; everything is written to `<runs>/<name>/`."""
    dataset: str = "data/intersection"
    """Folder with transforms.json and images."""
    runs: str = "runs"
    """Folder that holds the runs."""
    image_size: int = 0
    """Width to which pictures are reduced; 0 keeps theirs."""
    seed: int = 0
    """Seed of every random choice."""
    threads: int = 0
    """Processor threads; 0 uses all cores."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where networks run; `auto` takes a GPU if there is one."""
    overwrite: bool = False
    """Start the stage over instead of continuing it."""
    pcvae: PcvaeConfig = field(default_factory=PcvaeConfig)
    """Stage 1: pictures to beliefs."""
    nerf: NerfConfig = field(default_factory=NerfConfig)
    """Stage 2: beliefs to 3-D scenes."""
    mdn: MdnConfig = field(default_factory=MdnConfig)
    """Stage 3: beliefs to the next beliefs."""
    probe: ProbeConfig = field(default_factory=ProbeConfig)
    """Reading a scene's state from its density."""
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    """From sampled futures to a decision."""
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    """What the report measures."""

    def __post_init__(self):
        if self.image_size < 0:
            raise UserError(f"image_size is {self.image_size}; give a width in pixels, or 0 to keep the pictures' own")
        if self.threads < 0:
            raise UserError(f"threads is {self.threads}; give a number of threads, or 0 for all cores")

    @property
    def folder(self) -> Path:
        """Where the run lives; raises UserError for a name that is no plain word."""
        return run_folder(Path(self.runs), self.name)
