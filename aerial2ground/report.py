"""The report of a run from drone pictures to driving: report.html and report.json from what the stages left behind.

Only files of the run folder are read (see `report_results`), and the data set's road network for the maps where the
data set is still there.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from aerial2ground.ablation_charts import prior_views, priors_chart, split_views
from aerial2ground.config import AerialConfig
from aerial2ground.driving_charts import driven_paths, path_errors
from aerial2ground.localisation_charts import located_errors, located_paths
from aerial2ground.report_results import RunResults, ablation_folder, add_costs, read_run
from aerial2ground.report_sections import SECTIONS
from aerial2ground.report_words import PRIORS, town_key
from aerial2ground.road_network import RoadNetwork
from aerial2ground.stages import load_survey
from aerial2ground.table_charts import table_one_chart, table_two_chart
from aerial2ground.targets import derived, judge, required_keys
from hashnerf.figure_style import png_bytes
from hashnerf.image_files import read_rgb
from hashnerf.report_page import ReportKind, write_report
from hashnerf.run_info import run_info_now
from hashnerf.stage_costs import peak_memory_mb, stages_chart

TITLE = "aerial2ground report"
INTRO = (
    "Pictures from above become a radiance field, the field becomes pictures that a car would see, and these teach "
    "networks to steer and to tell where the car is. They are judged in the town as it is later: other light, moved "
    "objects, a real camera."
)
LIBRARIES = ("torch", "numpy", "embreex")
PICTURES = ("survey", "aerial_view", "ground_views")


def write_run_report(config: AerialConfig, command: str = "") -> Path:
    """Writes report.html and report.json into the run folder and returns the page's path.

    `command` is what the header names. Raises UserError for a run without reconstruction.json, and naming required
    figures that have neither a value nor a reason.
    """
    start = time.monotonic()
    run = read_run(config)
    survey = load_survey(config) if (Path(config.dataset) / "transforms.json").is_file() else None
    figures = draw_figures(run, config, survey.network if survey else None)
    add_costs(run, config.folder, time.monotonic() - start, peak_memory_mb())
    if run.results["stages"]:
        figures["stages"] = png_bytes(stages_chart(run.results["stages"]))
    world = (survey.data.extras.get("world") if survey else None) or {}
    scenario = world.get("scenario", Path(config.dataset).name)
    kind = ReportKind(
        title=TITLE,
        sections=SECTIONS,
        required_keys=lambda results: required_keys(run.trajectories, run.towns),
        derived=derived,
        judge=judge,
        intro=INTRO,
        footnote="± is one standard deviation.",
    )
    info = run_info_now(config.name, config.evaluation.preset, scenario, command, config.seed, LIBRARIES)
    return write_report(config.folder, kind, info, run.results, figures, run.reasons)


def draw_figures(run: RunResults, config: AerialConfig, network: RoadNetwork | None) -> dict[str, bytes]:
    """Returns the PNG files of all panels that the run has something for."""
    ground, towns, main = run.results["ground"], run.places, run.places.get(town_key(0), [])
    # The paths of drives that were made: a path that nobody drove has nothing to show.
    paths = {name: run.paths[name] for name in run.trajectories if name in run.paths}
    drawn: dict[str, tuple[bool, Callable]] = {
        "priors": (any(key != "main" for key in ground), lambda: priors_chart(ground)),
        "driven_paths": (bool(paths and run.drives), lambda: driven_paths(paths, run.drives, network)),
        "path_errors": (
            bool(paths and run.drives),
            lambda: path_errors(paths, run.drives, config.drive.intervention),
        ),
        "drive_errors": (bool(run.results["table2"]), lambda: table_two_chart(run.results["table2"])),
        "located_paths": (bool(main), lambda: located_paths(main, network)),
        "located_errors": (bool(towns), lambda: located_errors(towns)),
        "place_errors": (any(run.results["table1"].values()), lambda: table_one_chart(run.results["table1"])),
    }
    figures = {name: png_bytes(draw()) for name, (wanted, draw) in drawn.items() if wanted}
    for name in PICTURES:
        path = config.folder / f"{name}.png"
        if path.is_file():
            figures[name] = path.read_bytes()
    return figures | _prior_views(config)


def _prior_views(config: AerialConfig) -> dict[str, bytes]:
    truth, views = [], {}
    for prior in PRIORS:
        path = ablation_folder(config.folder, prior) / "ground_views.png"
        pairs = (
            split_views(np.asarray(read_rgb(path)), config.camera.height, config.camera.width)
            if path.is_file()
            else None
        )
        if pairs:
            truth = [true for true, _ in pairs]
            views[prior] = [seen for _, seen in pairs]
    same = {prior: rows for prior, rows in views.items() if len(rows) == len(truth)}
    return {"prior_views": png_bytes(prior_views(truth, same))} if truth else {}
