"""The tables of a report, read from the nested results and formatted for people; the paper's figures stand beside."""

from collections.abc import Mapping

from aerial2ground.report_words import DRIVERS, LOCATORS, PRIORS, VIEW_FIGURES, paper_drive, paper_place
from hashnerf.report_tables import DASH, Table, number

UNITS = {"psnr_db": "dB", "ssim": "", "road_psnr_db": "dB", "foreground_psnr_db": "dB"}
UNITS |= {"hidden_road_psnr_db": "dB", "road_depth_rmse_m": "m"}
VIEW_LABELS = {
    "psnr_db": "PSNR",
    "ssim": "SSIM",
    "road_psnr_db": "road PSNR",
    "foreground_psnr_db": "PSNR of what stands",
    "hidden_road_psnr_db": "PSNR of road hidden from above",
    "road_depth_rmse_m": "road depth RMSE up to 2 m",
}


def spread(row: Mapping, key: str, unit: str = "", digits: int | None = None) -> str:
    """A mean with its standard deviation over runs, where the row holds one."""
    text, around = number(row.get(key), unit, digits), row.get(f"{key}_spread")
    if row.get(key) is None or around is None:
        return text
    value, _, name = text.partition(" ")
    return f"{value} ± {number(around, unit, digits).split(' ')[0]} {name}".rstrip()


def reconstruction_tables(results: Mapping) -> list[Table]:
    """Held-out drone pictures, and the poses before and after refinement."""
    nerf, poses = results.get("nerf", {}), results.get("poses", {})
    rows = (
        ("from poses aligned to the field", number(nerf.get("aerial_heldout_psnr_db"), "dB")),
        ("from poses as told", number(nerf.get("aerial_heldout_psnr_as_told_db"), "dB")),
        ("pictures", number(nerf.get("test_pictures"))),
    )
    note = "Test pictures have noisy poses of their own: aligning moves their cameras, never the field."
    tables = [Table(("held-out drone pictures", "PSNR"), rows, note)]
    if poses:
        rows = tuple(
            (label, number(poses.get(f"{key}_m"), "m", 4), number(poses.get(f"{key}_deg"), "deg"))
            for key, label in (("told", "as told"), ("refined", "after refinement"))
        )
        tables.append(Table(("poses of training pictures", "position RMSE", "direction RMSE"), rows))
    return tables


def ground_tables(results: Mapping) -> list[Table]:
    """Views from the ground against the truth: of the run, and with parts of the road prior."""
    ground = results.get("ground", {})
    shown = [key for key in VIEW_FIGURES if _measured(ground, key)]
    rows = []
    if ground.get("main"):
        rows.append(("this run", *(number(ground["main"].get(key), UNITS[key]) for key in shown)))
    for prior, label in PRIORS.items():
        values = [ground.get(key, {}).get(prior) for key in shown]
        if any(value is not None for value in values):
            rows.append((f"prior: {label}", *(number(value, UNITS[key]) for value, key in zip(values, shown))))
    note = (
        "Rows with a prior are trainings that differ in nothing else, shorter than this run's; each adds to the last."
    )
    return [Table(("field", *(VIEW_LABELS[key] for key in shown)), tuple(rows), note)] if rows else []


def table_one(results: Mapping) -> list[Table]:
    """Table I: how far the network's poses are from the true ones, arrangement by arrangement."""
    rows = []
    for town, methods in results.get("table1", {}).items():
        for method, row in methods.items():
            paper = paper_place(town, method)
            rows.append(
                (
                    f"{town.replace('_', ' ')}, {LOCATORS[method]}",
                    spread(row, "pos_m", "m"),
                    DASH if paper is None else f"{paper[0]:.2f} m",
                    spread(row, "yaw_deg", "deg"),
                    DASH if paper is None else f"{paper[1]:.2f} deg",
                    number(row.get("pos_m_median"), "m"),
                    number(row.get("yaw_deg_median"), "deg"),
                )
            )
    header = ("houses, method", "position RMSE", "paper", "yaw RMSE", "paper", "median position", "median yaw")
    note = (
        "± is the standard deviation over networks. The paper's figures are of its own town, car and camera: compare "
        "the order of the methods, not the values. Baseline: trained on pictures from the ground."
    )
    return [Table(header, tuple(rows), note)] if rows else []


def table_two(results: Mapping) -> list[Table]:
    """Table II: how far drives strayed from their path, trajectory by trajectory."""
    rows = []
    for place, (path, methods) in enumerate(results.get("table2", {}).items()):
        for method, row in methods.items():
            paper = paper_drive(place, method)
            rows.append(
                (
                    f"{path.replace('_', ' ')}, {DRIVERS[method]}",
                    spread(row, "pos_m", "m"),
                    DASH if paper is None else f"{paper[0]:.2f} m",
                    spread(row, "yaw_deg", "deg"),
                    DASH if paper is None else f"{paper[1]:.2f} deg",
                    spread(row, "interventions", digits=1),
                    DASH if paper is None else f"{paper[2]}",
                    number(row.get("most_interventions")),
                    number(row.get("runs")),
                )
            )
    header = ("trajectory, method", "position RMSE", "paper", "yaw RMSE", "paper", "interventions a run", "paper")
    note = (
        "± is the standard deviation over drives. Expert: pure pursuit that knows its pose. Imit: imitation of a "
        "person's drives; Ours: from aerial pictures alone; GV: and from views around the person's drives, rendered "
        "from their pictures. The paper's figures are of its own town and car: compare the order, not the values."
    )
    return [Table((*header, "most", "drives"), tuple(rows), note)] if rows else []


def policy_tables(results: Mapping) -> list[Table]:
    """How long the steering network takes for one picture."""
    labels = {"latency_ms_1thread": "PyTorch, median", "p99_ms": "PyTorch, 99 %", "onnx_ms": "ONNX Runtime, median"}
    policy = results.get("policy", {})
    rows = tuple((label, number(policy[key], "ms", 2)) for key, label in labels.items() if policy.get(key) is not None)
    return [Table(("steering from one picture, one thread", "time"), rows)] if rows else []


def driving_tables(results: Mapping) -> list[Table]:
    """Table II and the time that a decision takes."""
    return table_two(results) + policy_tables(results)


def _measured(ground: Mapping, key: str) -> bool:
    values = [ground.get("main", {}).get(key), *ground.get(key, {}).values()]
    return any(value is not None for value in values)
