"""The tables of a report, read from the nested results and formatted for people.

Tables are rows of text. A value that is missing becomes a dash; shares are shown in per cent with their 95 % interval
where the results hold one.
"""

from collections.abc import Mapping, Sequence

from carff.planning_metrics import policy_label
from hashnerf.report_tables import DASH, Table, number
from hashnerf.targets import lookup


def share(value: float | int | None, interval: Sequence[float] | None = None) -> str:
    """A share in per cent with its interval in brackets."""
    if value is None or interval is None:
        return number(value, "%")
    return f"{number(value, '%')} [{100 * interval[0]:.1f}, {100 * interval[1]:.1f}]"


def data_tables(results: Mapping) -> list[Table]:
    """How many states, cameras and pictures there are."""
    data = results.get("data", {})
    names = (
        ("states", "states"),
        ("cameras", "cameras"),
        ("test_cameras", "test cameras"),
        ("views", "pictures"),
        ("determined_views", "pictures that determine their state"),
        ("ambiguous_views", "pictures that fit several states"),
    )
    known = [(label, number(data[key])) for key, label in names if data.get(key) is not None]
    return [Table(tuple(label for label, _ in known), (tuple(text for _, text in known),))] if known else []


def pcvae_tables(results: Mapping) -> list[Table]:
    """How well latents name their states and how well pictures come back."""
    pcvae = results.get("pcvae", {})
    names = (
        ("svm_all", "all training views"),
        ("svm_ceiling", "ceiling: what the pixels of all training views allow"),
        ("svm_visible", "training views that show the actor"),
        ("svm_visible_ceiling", "ceiling: what the pixels of those views allow"),
        ("svm_determined", "training views that determine their state"),
        ("svm_visible_heldout", "held-out cameras, actor visible"),
        ("svm_visible_heldout_ceiling", "ceiling: what the pixels of those views allow"),
        ("svm_heldout", "held-out cameras, all views"),
    )
    rows = tuple(
        (label, share(pcvae[key], pcvae.get(f"{key}_interval"))) for key, label in names if pcvae.get(key) is not None
    )
    note = "RBF support vector machine on standardised belief means, C = 1, 10-fold, equal pictures kept in one fold."
    more = (
        ("psnr_train_db", "PSNR, training views", "dB"),
        ("psnr_train_of_mean_mse_db", "PSNR of the mean squared error, training views", "dB"),
        ("psnr_heldout_db", "PSNR, held-out input cameras", "dB"),
        ("changed_px_db", "PSNR, changed pixels only", "dB"),
        ("psnr_mean_image_db", "PSNR of each camera's mean picture (a free baseline)", "dB"),
        ("active_units", "active latent dimensions", ""),
        ("needed_units", "dimensions that the states span at most", ""),
    )
    quality = tuple((label, number(pcvae[key], unit)) for key, label, unit in more if pcvae.get(key) is not None)
    return [Table(("state named from the latent", "accuracy"), rows, note), Table(("reconstruction", ""), quality)]


def scene_tables(results: Mapping) -> list[Table]:
    """PSNR of rendered scenes at the trained and the held-out camera, and the accuracy of the probe."""
    nerf = results.get("nerf", {})
    names = (
        ("psnr_matched", "against its own state"),
        ("psnr_unmatched", "against the other states"),
        ("changed_px", "changed pixels, own state"),
        ("changed_px_lead", "changed pixels, lead over the others"),
    )
    rows = tuple(
        (label, number(nerf.get(f"{key}_db"), "dB"), number(nerf.get(f"{key}_heldout_db"), "dB"))
        for key, label in names
    )
    found = (("renderings nearest to their own state", _count(nerf, ""), _count(nerf, "_heldout")),)
    probe = results.get("probe", {})
    tables = [Table(("bird's-eye view", "camera trained on", "camera held out"), rows + found)]
    if probe.get("accuracy") is not None:
        found = [("all answers", number(probe.get("views")), share(probe["accuracy"], probe.get("interval")))]
        for row in probe.get("by_evidence", ()):
            title = (
                f"{row['low']} pixels or more" if row["high"] is None else f"{row['low']} to {row['high'] - 1} pixels"
            )
            found.append((title, number(row["views"]), number(row["accuracy"], "%")))
        note = "Rows by pixels: in how many a view differs from the most similar one that asks for another answer."
        tables.append(Table(("density probe", "views", "accuracy"), tuple(found), note))
    return tables


def _count(nerf: Mapping, suffix: str) -> str:
    found, states = nerf.get(f"state_identified_count{suffix}"), nerf.get("states")
    return number(nerf.get(f"state_identified{suffix}"), "%") if found is None else f"{found} of {states}"


def forecast_tables(results: Mapping) -> list[Table]:
    """Calibration per visibility class and the branch probabilities of ambiguous views."""
    calibration = lookup(results, "forecast.calibration") or {}
    classes = calibration.get("by_visibility", {})
    rows = tuple(
        (name, number(row["views"]), number(row["ece"], digits=3), number(row["mae"], digits=3))
        for name, row in classes.items()
    )
    tables = []
    if rows:
        note = "Expected calibration error over 10 bins; mean absolute error view by view, where errors cannot cancel."
        tables.append(Table(("actor visibility", "views", "ECE", "MAE"), rows, note))
    use = lookup(results, "forecast.components")
    if use is not None:
        mixture = tuple(
            (label, number(use[key], digits=digits))
            for key, label, digits in (
                ("there", "components of the mixture", 0),
                ("used", "used, mean over views", 2),
                ("needed", "asked for by what may follow a picture, mean over views", 2),
                ("needed_most", "asked for by the picture that leaves most open", 0),
            )
        )
        tables.append(Table(("mixture of the forecast", ""), mixture, "Exponentials of entropies."))
    ambiguous = calibration.get("ambiguous", {})
    if ambiguous.get("mean_probability"):
        names = lookup(results, "data.branches") or [str(index) for index in range(len(ambiguous["mean_probability"]))]
        pairs = zip(names, ambiguous["mean_probability"], ambiguous["mean_frequency"])
        body = tuple((name, f"{chance:.2f}", f"{true:.2f}") for name, chance, true in pairs)
        title = f"branch, {ambiguous['views']} ambiguous views"
        tables.append(Table((title, "mean predicted probability", "true frequency"), body))
    return tables


def plan_tables(results: Mapping) -> list[Table]:
    """Success of every controller at a hazard and with a clear way."""
    rows = []
    for rule, entry in results.get("plan", {}).items():
        counts = {name: value for name, value in entry.items() if isinstance(value, Mapping)} or {"": entry}
        for name, row in counts.items():
            title = policy_label(rule, int(name[1:]) if name else None)
            rows.append((title, *_plan_cells(row, "hazard"), *_plan_cells(row, "clear")))
    header = ("controller", "hazard: waits", "trials", "worst image", "clear: goes", "trials", "worst image")
    note = " ".join(lookup(results, "plan_images.notes") or ())
    return [Table(header, tuple(rows), note)] if rows else []


def _plan_cells(row: Mapping, side: str) -> tuple[str, str, str]:
    count = row.get(f"{side}_count")
    trials = DASH if count is None else f"{count[0]} of {count[1]}"
    worst = row.get(f"{side}_worst_image")
    return share(row.get(f"{side}_success"), row.get(f"{side}_interval")), trials, number(worst, "%", 0)


def closed_loop_tables(results: Mapping) -> list[Table]:
    """Collisions, needless stops and time to cross of every policy."""
    rows = tuple(
        (
            policy_label(name),
            number(row.get("episodes")),
            f"{row['collisions']}",
            share(row.get("collision_rate"), row.get("collision_interval")),
            share(row.get("needless_stop_rate"), row.get("needless_stop_interval")),
            number(row.get("time_to_cross_s"), "s"),
        )
        for name, row in results.get("closed_loop", {}).items()
    )
    header = ("policy", "episodes", "collisions", "collision rate", "needless stops", "median time to cross")
    return [Table(header, rows)] if rows else []


def drive_tables(results: Mapping) -> list[Table]:
    """The policies side by side, and how often single pictures along the approach were decided rightly."""
    labels = {"hidden": "hides a hazard: waits", "shown": "shows a hazard: waits", "clear": "clear: goes"}
    found = results.get("approach", {})
    rows = tuple(
        (label, number(found[kind]["pictures"]), share(found[kind]["success"], found[kind]["interval"]))
        for kind, label in labels.items()
        if kind in found
    )
    along = [Table(("picture on the approach", "pictures", "right"), rows)] if rows else []
    return closed_loop_tables(results) + along
