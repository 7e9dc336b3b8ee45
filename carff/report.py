"""The report of a CARFF run: what it must hold and what it shows; `hashnerf.report_page` writes it."""

from collections.abc import Mapping
from pathlib import Path

from carff.report_sections import SECTIONS
from carff.targets import derived, judge
from hashnerf import report_page
from hashnerf.run_info import RunInfo

REQUIRED_KEYS = (
    "seconds_total",
    "decision_ms_n10",
    "pcvae.psnr_train_db",
    "pcvae.svm_all",
    "pcvae.svm_ceiling",
    "pcvae.svm_visible",
    "pcvae.svm_visible_heldout",
    "nerf.psnr_matched_db",
    "nerf.psnr_matched_heldout_db",
    "nerf.psnr_unmatched_db",
    "nerf.changed_px_db",
    "nerf.state_identified",
    "forecast.branch_ece",
    "probe.accuracy",
    *(
        f"plan.{rule}.n{draws}.{side}_success"
        for rule in ("risk", "paper")
        for draws in (2, 10, 35)
        for side in ("hazard", "clear")
    ),
    "closed_loop.risk.collisions",
    "closed_loop.risk.needless_stop_rate",
)

KIND = report_page.ReportKind(
    title="CARFF report",
    sections=SECTIONS,
    required_keys=lambda results: REQUIRED_KEYS,
    derived=derived,
    judge=judge,
    footnote="Brackets are 95 % intervals.",
)
PANEL_NAMES = frozenset(panel.name for panel in KIND.panels)


def write_report(
    folder: Path,
    run: RunInfo,
    results: Mapping,
    figures: Mapping[str, bytes],
    not_run: Mapping[str, str] | None = None,
) -> Path:
    """Writes report.html and report.json into `folder` and returns the page's path.

    Raises UserError naming required keys that have neither a value nor a reason, ValueError for figures no section
    shows.
    """
    return report_page.write_report(folder, KIND, run, results, figures, not_run)
