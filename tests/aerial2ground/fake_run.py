"""Made-up files of a finished run, for tests of its report: plausible, and nothing that was ever measured."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from aerial2ground.config import AerialConfig, layout_config
from aerial2ground.paths import Path as DrivingPath
from hashnerf.pipeline import note

STRAYS = {"expert": 0.006, "imit": 0.11, "imit_gv": 0.05, "ours": 0.035, "ours_gv": 0.025}
MISSES = {"baseline": (0.13, 5.0), "ours": (0.18, 6.0), "ours_imu": (0.07, 1.4)}
PRIORS = {"none": 17.1, "colour": 19.4, "colour_depth": 21.6, "full": 22.3}
HEIGHT, WIDTH = 18, 32


def loop(width: float, height: float, corner: float, shift: float = 0.0) -> list[list[float]]:
    """A closed round-cornered path [[x, y], ...] in metres."""
    points = []
    for number, (x, y) in enumerate(((width, height), (0, height), (0, 0), (width, 0))):
        middle = np.array([x + (-corner if x else corner), y + (-corner if y else corner)])
        angle = np.radians(90 * number + np.arange(0, 91, 6))
        points += (middle + corner * np.stack([np.cos(angle), np.sin(angle)], axis=1) + 0.75 + shift).tolist()
    return [*points, points[0]]


PATHS = {
    "outer_loop": loop(4.5, 3.5, 1.0),
    "left_turns": loop(2.2, 3.2, 0.6, 0.15),
    "right_turns": loop(3.9, 2.0, 0.5, 0.1)[::-1],
}


def fake_run(config: AerialConfig, paths: Mapping[str, Sequence] = PATHS) -> None:
    """Writes everything that the stages of a run leave behind, for `config.seed` and two drives of every method."""
    rng = np.random.default_rng(config.seed)
    folder = config.folder
    folder.mkdir(parents=True, exist_ok=True)
    ground = {"psnr_db": 23.4, "ssim": 0.81, "road_psnr_db": 22.8, "foreground_psnr_db": 20.6}
    ground |= {"hidden_road_psnr_db": 19.9, "hidden_road_share": 0.07, "road_depth_rmse_m": 0.013}
    poses = {"told_m": 0.0052, "told_deg": 0.61, "refined_m": 0.0041, "refined_deg": 0.42}
    aerial = {"seconds": 190.0, "test_pictures": 12, "aerial_psnr_db": 22.9, "aerial_psnr_aligned_db": 26.2}
    save(folder / "reconstruction.json", aerial | {"poses": poses, "ground": ground})
    picture(folder / "ground_views.png", rng, 6 * HEIGHT, 3 * WIDTH)
    picture(folder / "survey.png", rng, 60, 160)
    picture(folder / "aerial_view.png", rng, 60, 120)
    for prior, level in PRIORS.items():
        gain = level - PRIORS["full"]
        own = {key: value + gain for key, value in ground.items() if key.endswith("_db")}
        own |= {"ssim": 0.81 + gain / 60, "road_depth_rmse_m": 0.015 * 10 ** (-gain / 5), "hidden_road_share": 0.07}
        save(folder / "ablation" / prior / "reconstruction.json", {"seconds": 80.0, "test_pictures": 12, "ground": own})
        picture(folder / "ablation" / prior / "ground_views.png", rng, 6 * HEIGHT, 3 * WIDTH)
    save(folder / "driving.json", fake_driving(rng, paths))
    for number in range(config.evaluation.layouts):
        save(layout_config(config, number).folder / "localisation.json", fake_places(rng, paths))
    save(folder / "latency.json", {"latency_ms_1thread": 0.62, "p99_ms": 0.9, "onnx_ms": 0.11})
    note(folder, "survey of a", 9.0, 300.0, within="drone surveys")
    note(folder, "survey of b", 11.0, 310.0, within="drone surveys")
    for name, seconds in (("drone surveys", 12.0), ("radiance fields", 300.0), ("views and their figures", 170.0)):
        note(folder, name, seconds, 900.0)
    note(folder, "steering networks", 140.0, 500.0)
    note(folder, "drives and localisation", 80.0, 450.0)


def fake_driving(rng: np.random.Generator, paths: Mapping[str, Sequence]) -> dict:
    """Returns a driving.json: two drives of two laps of every method."""
    table, tracks = {}, []
    for name, points in paths.items():
        path = DrivingPath(np.array(points))
        for method, size in STRAYS.items():
            rows = []
            for seed in range(2):
                arc = np.arange(0, 2 * path.length, 0.1)
                wave = np.sin(arc * 2.1 + rng.uniform(0, 6)) + 0.7 * np.sin(arc * 0.8 + rng.uniform(0, 6))
                aside = size * (wave + 0.3 * rng.normal(size=len(arc)))
                heading = np.gradient(size * wave, arc) + 0.01 * rng.normal(size=len(arc))
                place = path.poses(arc)
                left = np.stack([-np.sin(place[:, 2]), np.cos(place[:, 2])], axis=1)
                track = place[:, :2] + aside[:, None] * left
                far = np.flatnonzero((abs(aside[1:]) > 0.175) & (abs(aside[:-1]) <= 0.175))
                rows.append((np.sqrt(np.mean(aside**2)), np.degrees(np.sqrt(np.mean(heading**2))), len(far)))
                tracks.append(
                    {"trajectory": name, "method": method, "seed": seed}
                    | {"track": track.tolist(), "lateral": abs(aside).tolist(), "heading": heading.tolist()}
                    | {"put_back": track[far].tolist()}
                )
            metres, degrees, counts = np.array(rows).T
            table.setdefault(name, {})[method] = {
                "pos_m": metres.mean(),
                "pos_m_spread": metres.std(),
                "yaw_deg": degrees.mean(),
                "yaw_deg_spread": degrees.std(),
                "interventions": counts.mean(),
                "most_interventions": int(counts.max()),
                "runs": 2,
            }
    return {"table2": table, "paths": dict(paths), "tracks": tracks}


def fake_places(rng: np.random.Generator, paths: Mapping[str, Sequence]) -> dict:
    """Returns a localisation.json: a lap of every path."""
    tracks, errors = [], {method: [] for method in MISSES}
    for name, points in paths.items():
        path = DrivingPath(np.array(points))
        truth = path.poses(np.arange(0, path.length, 0.1))
        track = {"trajectory": name, "truth": truth.tolist()}
        for method, (metres, degrees) in MISSES.items():
            rows = rng.standard_t(4, size=(len(truth), 3)) * [metres / 2, metres / 2, np.radians(degrees) / 1.4]
            if method == "ours":
                rows[rng.random(len(rows)) < 0.02, :2] += 1.5
            if method == "ours_imu":
                rows = np.stack([np.convolve(column, np.ones(9) / 4, "same") for column in rows.T], axis=1)
            errors[method].append(rows)
            track[method] = (truth + rows).tolist()
        tracks.append(track)
    table = {}
    for method, parts in errors.items():
        rows = np.concatenate(parts)
        distance, turn = np.linalg.norm(rows[:, :2], axis=1), np.degrees(abs(rows[:, 2]))
        table[method] = {
            "pos_m": np.sqrt(np.mean(distance**2)),
            "pos_m_spread": 0.01,
            "yaw_deg": np.sqrt(np.mean(turn**2)),
            "yaw_deg_spread": 0.3,
            "pos_m_median": np.median(distance),
            "yaw_deg_median": np.median(turn),
            "runs": 2,
        }
    return {"table1": table, "views": 1200, "test_pictures": sum(map(len, tracks)), "tracks": tracks}


def picture(path: Path, rng: np.random.Generator, height: int, width: int) -> None:
    """Writes a picture of smooth noise."""
    small = rng.integers(0, 256, (height // 6 + 1, width // 6 + 1, 3)).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(small).resize((width, height), Image.Resampling.BICUBIC).save(path)


def save(path: Path, document: dict) -> None:
    """Writes a document as JSON, its folder as well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))
