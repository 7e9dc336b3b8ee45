"""What a run from drone pictures to driving must reach, preset by preset, and which keys its report must hold.

Keys are dotted paths into the nested results, see `hashnerf.targets`. `derived` adds the figures that sum up tables: in
`table1_worst` and `table2_worst` the worst arrangement of houses or trajectory of a method, in `table2_order` how much
more than Imit + GV our Ours + GV has of an error, mean over trajectories (0 or less: at least as good), in `prior_gain`
what the whole road prior adds to views from the ground.
"""

from collections.abc import Mapping, Sequence

from aerial2ground.report_words import DRIVE_FIGURES, JUDGED_DRIVERS, LOCATORS, PLACE_FIGURES, PRIORS, VIEW_FIGURES
from hashnerf.targets import WHOLE_RUN, Target, Verdict, lookup
from hashnerf.targets import judge as judge_targets

TARGETS = (
    Target("seconds_total", "whole run after installation", "<=", "min", 900.0, 3600.0),
    Target("nerf.aerial_heldout_psnr_db", "held-out drone pictures, poses aligned", ">=", "dB", 25.0, 29.0),
    Target("ground.main.road_psnr_db", "views from the ground: road", ">=", "dB", 21.0, 25.0),
    Target("ground.main.foreground_psnr_db", "views from the ground: what stands", ">=", "dB", 20.0, 23.0),
    Target(
        "ground.main.road_depth_rmse_m", "views from the ground: depth of the road up to 2 m", "<=", "m", 0.02, 0.01
    ),
    Target(
        "prior_gain.hidden_road_psnr_db", "road prior: gain where the road is hidden from above", ">=", "dB", None, None
    ),
    Target("poses.refined_m", "drone's positions after refinement", "<=", "m", 0.01, 0.005),
    Target("poses.refined_deg", "drone's directions after refinement", "<=", "deg", 0.5, 0.2),
    Target("table2_worst.ours.pos_m", "Table II, Ours, worst trajectory: position", "<=", "m", 0.05, 0.03, "0.36 m"),
    Target("table2_worst.ours.yaw_deg", "Table II, Ours, worst trajectory: yaw", "<=", "deg", 4.0, 3.0, "10.75 deg"),
    Target(
        "table2_worst.ours.interventions",
        "Table II, Ours, worst trajectory: interventions a run",
        "<=",
        "",
        1.0,
        0.0,
        "5",
    ),
    Target("table2_order.pos_m", "Ours + GV less Imit + GV: position", "<=", "m", 0.0, 0.0, "−0.097 m"),
    Target("table2_order.yaw_deg", "Ours + GV less Imit + GV: yaw", "<=", "deg", 0.0, 0.0, "−4.09 deg"),
    Target("table2_order.interventions", "Ours + GV less Imit + GV: interventions a run", "<=", "", 0.0, 0.0, "−1.33"),
    Target("table1_worst.ours.pos_m", "Table I, Ours, worst houses: position", "<=", "m", 0.30, 0.15, "0.21 m"),
    Target("table1_worst.ours.yaw_deg", "Table I, Ours, worst houses: yaw", "<=", "deg", 10.0, 5.0, "8.61 deg"),
    Target(
        "table1_worst.ours_imu.pos_m", "Table I, Ours + IMU, worst houses: position", "<=", "m", 0.12, 0.08, "0.12 m"
    ),
    Target(
        "table1_worst.ours_imu.yaw_deg", "Table I, Ours + IMU, worst houses: yaw", "<=", "deg", 3.0, 1.5, "2.26 deg"
    ),
    Target("policy.latency_ms_1thread", "steering from one picture, one thread", "<=", "ms", 2.0, 2.0),
)


def required_keys(trajectories: Sequence[str], towns: Sequence[str]) -> list[str]:
    """The keys that every report holds: a value, or a reason why there is none. Without trajectories: `table2`."""
    drives = [
        f"table2.{path}.{driver}.{key}" for path in trajectories for driver in JUDGED_DRIVERS for key in DRIVE_FIGURES
    ]
    return [
        "seconds_total",
        "nerf.aerial_heldout_psnr_db",
        *(f"ground.{key}.{prior}" for key in ("psnr_db", "road_depth_rmse_m") for prior in PRIORS),
        *(f"table1.{town}.{locator}.{key}" for town in towns for locator in LOCATORS for key in PLACE_FIGURES),
        *(drives or ["table2"]),
        "policy.latency_ms_1thread",
    ]


def derived(results: Mapping) -> dict:
    """The results with the figures that sum up the tables."""
    drives, places = results.get("table2", {}), results.get("table1", {})
    more = {
        "table1_worst": {name: _worst(places, name, PLACE_FIGURES) for name in LOCATORS},
        "table2_worst": {name: _worst(drives, name, DRIVE_FIGURES) for name in JUDGED_DRIVERS},
        "table2_order": {key: _mean_difference(drives, "ours_gv", "imit_gv", key) for key in DRIVE_FIGURES},
        "prior_gain": {key: _difference(results, f"ground.{key}.full", f"ground.{key}.none") for key in VIEW_FIGURES},
    }
    return dict(results) | more


def judge(results: Mapping, preset: str, not_run: Mapping[str, str]) -> list[Verdict]:
    """Every target beside its measurement; a figure that sums up a table is missing for the table's reason."""

    def exempt(target: Target, limit: float | None) -> str | None:
        cover = results.get("seconds_cover", WHOLE_RUN)
        return cover if target.key == "seconds_total" and cover != WHOLE_RUN else None

    reasons = dict(not_run)
    for parts, whole in (
        (("table1_worst",), "table1"),
        (("table2_worst", "table2_order"), "table2"),
        (("prior_gain",), "ground"),
    ):
        why = next((reason for key, reason in not_run.items() if key.split(".")[0] == whole), None)
        reasons |= {part: why for part in parts if why and part not in reasons}
    return judge_targets(TARGETS, results, preset, reasons, exempt)


def _worst(table: Mapping, method: str, keys: Sequence[str]) -> dict[str, float | int | None]:
    rows = [rows[method] for rows in table.values() if method in rows]
    return {key: max((row[key] for row in rows if row.get(key) is not None), default=None) for key in keys}


def _mean_difference(table: Mapping, method: str, other: str, key: str) -> float | None:
    pairs = [(lookup(rows, f"{method}.{key}"), lookup(rows, f"{other}.{key}")) for rows in table.values()]
    both = [a - b for a, b in pairs if a is not None and b is not None]
    return sum(both) / len(both) if both else None


def _difference(results: Mapping, key: str, other: str) -> float | None:
    a, b = lookup(results, key), lookup(results, other)
    return None if a is None or b is None else a - b
