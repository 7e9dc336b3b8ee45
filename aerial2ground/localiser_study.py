"""What a localiser needs: its error against the number of views and the size of the network.

Networks learn from views of the radiance field or from true pictures of the town, in the drone's light, at places drawn
alike. They are tried on other pictures of their own kind and on drives through the town as it is now. Where the curve
of true pictures falls and that of the field does not, the field is what is wrong, not the network.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from matplotlib.figure import Figure
from torch import Tensor

from aerial2ground.config import AerialConfig
from aerial2ground.evaluation_stages import TestDrive
from aerial2ground.ground_poses import GroundPoses, disturbed_poses
from aerial2ground.ground_truth import true_views
from aerial2ground.ground_views import cameras_of, nerf_renderer
from aerial2ground.learning_stages import origin_of, pictures_of, town_of
from aerial2ground.localisation import pose_distances, train_localiser
from aerial2ground.stages import Survey, load_driven_survey, load_nerf
from hashnerf.errors import UserError
from hashnerf.figure_style import BLUE, FULL_WIDTH, SMALL, VERMILION, new_figure, style_chart
from hashnerf.results_page import markdown_table

SOURCES = {"field": "views of the field", "truth": "true pictures"}
COLOURS = {"field": BLUE, "truth": VERMILION}
ELSEWHERE, OTHER_PLACES = 60, 3_000
"""Pictures per trajectory on which a network is tried, and what is added to the seed that draws their places."""


@dataclass(frozen=True)
class Case:
    """One network of the study."""

    source: str
    views: int
    """Per trajectory."""
    filters: int


@dataclass(frozen=True)
class Errors:
    """Of one network: root mean squares in metres and degrees, the median in metres."""

    own_m: float
    own_deg: float
    now_m: float
    now_deg: float
    now_median_m: float


@dataclass(frozen=True)
class Pictures:
    """Pictures along all trajectories, one after the other in each, and where the car stood."""

    pictures: tuple[UInt8[Tensor, "_ h w 3"], ...]
    sky: tuple[Bool[Tensor, "_ h w"], ...]
    poses: tuple[Float[np.ndarray, "_ 3"], ...]

    def thinned(self, count: int) -> "Pictures":
        """The same paths with `count` pictures each, spread evenly."""
        rows = [np.linspace(0, len(one) - 1, count).round().astype(int) for one in self.poses]
        return Pictures(
            tuple(value[row] for value, row in zip(self.pictures, rows)),
            tuple(value[row] for value, row in zip(self.sky, rows)),
            tuple(value[row] for value, row in zip(self.poses, rows)),
        )


def cases(views: Sequence[int], filters: Sequence[int], most_of_field: int) -> list[Case]:
    """Returns the networks: every number of views with the smallest size, every larger one with most views.

    The field has `most_of_field` views per trajectory; true pictures can be had for the asking.
    """
    if not views or not filters or min(*views, 2) < 2 or min(filters) < 1:
        raise UserError(f"views {list(views)} and filters {list(filters)}: give numbers of 2 or more, and of 1 or more")
    found, filters = [], sorted(filters)
    for source, own in (("field", [n for n in views if n <= most_of_field] or [most_of_field]), ("truth", list(views))):
        found += [Case(source, count, filters[0]) for count in own]
        found += [Case(source, max(own), size) for size in filters[1:]]
    return found


def true_pictures(config: AerialConfig, survey: Survey, count: int, seed: int) -> Pictures:
    """Renders the town in the drone's light, as sharp as it is, at `count` places per trajectory."""
    town, (east, north) = town_of(config, survey), origin_of(survey)
    parts = []
    for car in _places(config, survey, count, seed):
        moved = replace(car, poses=car.poses + np.array([east, north, 0.0]))
        seen = true_views(town, cameras_of(config.camera, moved, 0.0))
        rgb = torch.stack([view.rgb for view in seen])
        parts.append((rgb, torch.stack([view.depth for view in seen]) == 0, car.poses))
    return Pictures(*(tuple(column) for column in zip(*parts)))


def field_pictures(config: AerialConfig, survey: Survey, count: int, seed: int) -> Pictures:
    """Renders the run's field at `count` places per trajectory."""
    nerf, _ = load_nerf(config, survey)
    render, parts = nerf_renderer(nerf), []
    for car in _places(config, survey, count, seed):
        cameras = cameras_of(config.camera, car, survey.network.heights_at(torch.from_numpy(car.poses[:, :2])))
        rgb, depth = (np.stack(part) for part in zip(*render(cameras, range(count))))
        parts.append((torch.from_numpy(rgb), torch.from_numpy(depth) == 0, car.poses))
    return Pictures(*(tuple(column) for column in zip(*parts)))


def stored_views(config: AerialConfig, survey: Survey) -> Pictures:
    """Returns the run's ground views: what its own localisers learn from."""
    views = [pictures_of(config, "ours", name)[0] for name in survey.trajectories]
    return Pictures(tuple(v.pictures for v in views), tuple(v.sky for v in views), tuple(v.poses for v in views))


def _places(config: AerialConfig, survey: Survey, count: int, seed: int) -> list[GroundPoses]:
    return [
        disturbed_poses(path, count, config.imitation.disturbance, np.random.default_rng([seed, number]))
        for number, path in enumerate(survey.trajectories.values())
    ]


@dataclass(frozen=True)
class Trainer:
    """Trains and tries networks; every process gets its own copy of the pictures."""

    config: AerialConfig
    learn: Mapping[str, Pictures]
    elsewhere: Mapping[str, Pictures]
    drives: Sequence[TestDrive]

    def __call__(self) -> Callable[[Case], Errors]:
        return self.errors_of

    def errors_of(self, case: Case) -> Errors:
        """Trains one network and tries it."""
        task = self.config.localisation.task
        task = replace(task, network=replace(task.network, filters=case.filters, depth=False))
        own = self.learn[case.source].thinned(case.views)
        localiser = train_localiser(
            own.pictures, own.poses, task, self.config.seed, own.sky, self.config.localisation.loss
        )
        other = self.elsewhere[case.source]
        own_m, own_deg = pose_distances(localiser(torch.cat(other.pictures)), np.concatenate(other.poses))
        pictures = torch.cat([drive.pictures for drive in self.drives])
        now_m, now_deg = pose_distances(localiser(pictures), np.concatenate([drive.poses for drive in self.drives]))
        return Errors(_rms(own_m), _rms(own_deg), _rms(now_m), _rms(now_deg), float(np.median(now_m)))


def prepare(config: AerialConfig, views: Sequence[int]) -> tuple[dict[str, Pictures], dict[str, Pictures]]:
    """Returns what networks learn from and other pictures of the same kinds."""
    survey = load_driven_survey(config)
    learn = {"field": stored_views(config, survey), "truth": true_pictures(config, survey, max(views), config.seed)}
    seed = config.seed + OTHER_PLACES
    elsewhere = {
        "field": field_pictures(config, survey, ELSEWHERE, seed),
        "truth": true_pictures(config, survey, ELSEWHERE, seed),
    }
    return learn, elsewhere


def study_table(results: Mapping[Case, Errors], paths: int) -> str:
    """Returns Markdown: one row a network."""
    head = [
        "learned from",
        "views",
        "filters",
        "own kind, m",
        "own kind, deg",
        "town now, m",
        "median, m",
        "town now, deg",
    ]
    rows = [
        [
            SOURCES[case.source],
            str(case.views * paths),
            str(case.filters),
            f"{errors.own_m:.2f}",
            f"{errors.own_deg:.1f}",
            f"{errors.now_m:.2f}",
            f"{errors.now_median_m:.2f}",
            f"{errors.now_deg:.1f}",
        ]
        for case, errors in results.items()
    ]
    return markdown_table([head, *rows])


def smallest_that_can(results: Mapping[Case, Errors], target: float) -> dict[str, Case | None]:
    """Returns per source the network with fewest filters, then views, that meets a target (m) in the town as it is."""
    able = {source: [c for c, e in results.items() if c.source == source and e.now_m <= target] for source in SOURCES}
    return {source: min(own, key=lambda c: (c.filters, c.views), default=None) for source, own in able.items()}


def words(case: Case | None, paths: int) -> str:
    """Says which network it is."""
    return "none" if case is None else f"the one with {case.filters} filters after {case.views * paths} views"


def study_chart(results: Mapping[Case, Errors], paths: int, target: float) -> Figure:
    """Errors against views, and against filters, of both sources; thin lines: on other pictures of their own kind."""
    figure = new_figure(FULL_WIDTH, 3.6)
    left, right = figure.subplots(1, 2, sharey=True)
    filters = min(case.filters for case in results)
    for source, label in SOURCES.items():
        own = [case for case in results if case.source == source]
        most = max(case.views for case in own)
        curves = (
            (left, sorted((c for c in own if c.filters == filters), key=lambda c: c.views), lambda c: c.views * paths),
            (right, sorted((c for c in own if c.views == most), key=lambda c: c.filters), lambda c: c.filters),
        )
        for axes, line, place in curves:
            x = [place(case) for case in line]
            axes.plot(x, [results[c].now_m for c in line], "o-", color=COLOURS[source], label=f"{label}, town now")
            axes.plot(
                x, [results[c].own_m for c in line], "o--", color=COLOURS[source], linewidth=0.9, markersize=3,
                label=f"{label}, own kind",
            )  # fmt: skip
    for axes, name in ((left, "views"), (right, "filters of every convolution")):
        axes.axhline(target, color="black", linewidth=0.8, linestyle=":")
        axes.set_xscale("log", base=2)
        axes.set_ylim(bottom=0)
        style_chart(axes, "", name, "position RMSE (m)" if axes is left else "")
    left.legend(fontsize=SMALL, frameon=False)
    return figure


def _rms(values: Float[np.ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
