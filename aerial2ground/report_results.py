"""Reads what the stages of a run have measured, as the nested results of its report, with reasons for what is missing.

    <run>/reconstruction.json                      the radiance field            -> nerf, poses, ground.main
    <run>/ablation/<prior>/reconstruction.json     fields with parts of the road prior -> ground.<figure>.<prior>
    <run>/driving.json                             Table II                      -> table2
    <run>/localisation.json, and that of the runs on other arrangements of houses -> table1.layout_<n>
    <run>/latency.json                             one picture, one thread       -> policy
    <run>/timings.json                             hashnerf.pipeline             -> stages, seconds_total

Every file may hold `not_run`: key -> reason, for figures that could not be measured; in localisation.json the keys are
those of its `table1`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aerial2ground.config import AerialConfig, layout_config
from aerial2ground.report_words import DRIVERS, JUDGED_DRIVERS, LOCATORS, PRIORS, VIEW_FIGURES, town_key
from hashnerf.errors import UserError
from hashnerf.model_files import has_model, weights_digest
from hashnerf.pipeline import read_timings, total_seconds
from hashnerf.stage_costs import ordered_stages
from hashnerf.targets import WHOLE_RUN
from hashnerf.transforms_json import read_transforms

RECONSTRUCTION, DRIVING, LOCALISATION, LATENCY = (
    f"{name}.json" for name in ("reconstruction", "driving", "localisation", "latency")
)
TIMED = ("drone surveys", "radiance fields", "views and their figures", "steering networks", "drives and localisation")
"""Stages of scripts/demo_aerial.py: a run whose timings hold all of them was timed as a whole."""
NO_WORLD = "no embedded world stands behind the pictures, so there is no truth to compare with"
NO_PERSON = "needs pictures that a person collected from the ground, and no such network was trained"


@dataclass
class RunResults:
    """What a run's files tell."""

    results: dict = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    paths: dict[str, list] = field(default_factory=dict)
    """Trajectory -> points [[x, y], ...]."""
    drives: list[dict] = field(default_factory=list)
    """The tracks of driving.json."""
    places: dict[str, list[dict]] = field(default_factory=dict)
    """Arrangement of houses -> the tracks of its localisation.json."""

    @property
    def trajectories(self) -> list[str]:
        """Names of the paths, in the order of Table II."""
        return list(self.results.get("table2", {})) or list(self.paths)

    @property
    def towns(self) -> list[str]:
        """Names of the arrangements of houses, in the order of Table I."""
        return list(self.results.get("table1", {}))


def ablation_folder(run: Path, prior: str) -> Path:
    """Where the run with a part of the road prior lives."""
    return run / "ablation" / prior


def read_run(config: AerialConfig) -> RunResults:
    """Reads everything; raises UserError where there is no reconstruction.json, without which there is no report."""
    run = RunResults()
    _read_reconstruction(run, config.folder)
    for prior in PRIORS:
        _read_prior(run, config.folder, prior)
    _read_driving(run, config.folder)
    for number in range(config.evaluation.layouts):
        _read_localisation(run, layout_config(config, number).folder, town_key(number))
    latency = _read(run, config.folder / LATENCY, ("policy",))
    run.results["policy"] = {key: value for key, value in latency.items() if key != "not_run"}
    run.reasons |= latency.get("not_run", {})
    return run


def add_costs(run: RunResults, folder: Path, own_seconds: float, own_memory_mb: float) -> None:
    """Adds time and memory of the stages; the report itself has taken `own_seconds` so far."""
    timed = read_timings(folder)
    if not timed:
        run.reasons["seconds_total"] = "the stages were called one by one; scripts/demo_aerial.py times the whole run"
    else:
        timed["report"] = {"seconds": own_seconds, "peak_memory_mb": own_memory_mb}
        missing = [name for name in TIMED if name not in timed]
        run.results["seconds_total"] = total_seconds(timed)
        run.results["seconds_cover"] = f"without {', '.join(missing)}" if missing else WHOLE_RUN
    run.results["stages"] = ordered_stages(timed)


def _read(run: RunResults, path: Path, keys: Sequence[str]) -> dict:
    """The document, or an empty one with a reason for `keys`."""
    if path.is_file():
        return read_transforms(path)
    run.reasons |= dict.fromkeys(keys, f"the run holds no {path.name}")
    return {}


def _read_reconstruction(run: RunResults, folder: Path) -> None:
    path = folder / RECONSTRUCTION
    if not path.is_file():
        raise UserError(f"{folder}: holds no {RECONSTRUCTION}; run scripts/evaluate_reconstruction.py first")
    document = read_transforms(path)
    field = folder / "reconstruction"
    if "weights" in document and has_model(field) and document["weights"] != weights_digest(field):
        raise UserError(
            f"{path}: was measured on another field than {field} holds; run scripts/evaluate_reconstruction.py again, "
            "and the stages after it"
        )
    run.reasons |= document.get("not_run", {})
    names = {
        "aerial_psnr_aligned_db": "aerial_heldout_psnr_db",
        "aerial_psnr_db": "aerial_heldout_psnr_as_told_db",
        "test_pictures": "test_pictures",
        "seconds": "seconds",
    }
    run.results["nerf"] = {name: document[key] for key, name in names.items() if key in document}
    if document.get("test_pictures") == 0:
        run.reasons.setdefault("nerf.aerial_heldout_psnr_db", "no drone picture is held out")
    run.results["poses"] = document.get("poses", {})
    if not run.results["poses"]:
        run.reasons.setdefault("poses", "the true poses of the drone's pictures are not known")
    run.results["ground"] = {"main": _ground(run, document, "ground.main")}


def _read_prior(run: RunResults, folder: Path, prior: str) -> None:
    path = ablation_folder(folder, prior) / RECONSTRUCTION
    keys = [f"ground.{figure}.{prior}" for figure in VIEW_FIGURES]
    if not path.is_file():
        run.reasons |= dict.fromkeys(keys, f"no field was trained with this part of the road prior ({PRIORS[prior]})")
        return
    document = read_transforms(path)
    if "ground" not in document:
        run.reasons |= dict.fromkeys(keys, NO_WORLD)
    for figure, value in document.get("ground", {}).items():
        run.results["ground"].setdefault(figure, {})[prior] = value
        if value is None:
            run.reasons[f"ground.{figure}.{prior}"] = "no pixel of that kind is in the views"


def _ground(run: RunResults, document: Mapping, parent: str) -> dict:
    ground = dict(document.get("ground", {}))
    if not ground:
        run.reasons.setdefault(parent, NO_WORLD)
    empty = [f"{parent}.{figure}" for figure, value in ground.items() if value is None]
    run.reasons |= dict.fromkeys(empty, "no pixel of that kind is in the views")
    return ground


def _read_driving(run: RunResults, folder: Path) -> None:
    document = _read(run, folder / DRIVING, ("table2",))
    run.results["table2"] = {
        path: {driver: rows[driver] for driver in DRIVERS if driver in rows}
        for path, rows in document.get("table2", {}).items()
    }
    run.paths, run.drives = document.get("paths", {}), document.get("tracks", [])
    drove = {driver for rows in run.results["table2"].values() for driver in rows}
    for driver in JUDGED_DRIVERS:
        # A network that drove nowhere was not to be had; one that drove here and not there is missing.
        if driver != "ours" and driver not in drove:
            run.reasons |= {f"table2.{path}.{driver}": NO_PERSON for path in run.results["table2"]}
    run.reasons |= document.get("not_run", {})


def _read_localisation(run: RunResults, folder: Path, town: str) -> None:
    document = _read(run, folder / LOCALISATION, (f"table1.{town}",))
    table = document.get("table1", {})
    run.results.setdefault("table1", {})[town] = {name: table[name] for name in LOCATORS if name in table}
    about = {key: document[key] for key in ("views", "test_pictures") if key in document}
    run.results.setdefault("localisation", {})[town] = about
    if table and "baseline" not in table:
        run.reasons[f"table1.{town}.baseline"] = NO_PERSON
    run.reasons |= {f"table1.{town}.{key}": reason for key, reason in document.get("not_run", {}).items()}
    if document.get("tracks"):
        run.places[town] = document["tracks"]
