"""Replay a drive from its black box: do the same inputs give the same bytes, and the same pictures the same answers?

python scripts/replay_drive.py --log runs/bridge/20260101-120000 [--policy policy.onnx] [--chart drive.png]
"""

from dataclasses import dataclass
from pathlib import Path

from aerial2ground.bridge.drive_chart import drive_chart
from aerial2ground.bridge.recorded_pictures import replay_answers
from aerial2ground.bridge.replay import WRONG, read_log, replay
from aerial2ground.exported_policy import load_exported
from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError
from hashnerf.figure_style import png_bytes
from hashnerf.transforms_json import write_atomically


@dataclass(frozen=True)
class ReplayConfig:
    """Which drive."""

    log: Path
    """Folder of one drive, below the --log of scripts/deploy_racecar.py."""
    policy: str = ""
    """The policy that drove, to let it answer the pictures again (the drive must have been recorded: --record true)."""
    chart: str = ""
    """PNG file for a chart of what happened; empty: none."""


def draw(log: Path, chart: Path) -> None:
    """Writes the chart of a drive; raises UserError for a place where no file belongs, and for a damaged black box."""
    if (chart.exists() and not chart.is_file()) or not chart.absolute().parent.is_dir():
        raise UserError(f"--chart {chart}: no picture can be written there; give a file in a folder that exists")
    try:
        picture = png_bytes(drive_chart(read_log(log)))
    except WRONG as error:
        raise UserError(f"{log}: cannot be drawn ({error}); the black box is damaged") from error
    write_atomically(chart, picture)


def main() -> int:
    """Replay; exit code 1 where something differs."""
    config = parse_config(ReplayConfig, description="Replay a drive from its black box.")
    found = replay(config.log)
    print(f"{found.periods} periods, {found.different} with other bytes; faults: {', '.join(found.faults) or 'none'}")
    if config.chart:
        draw(config.log, Path(config.chart))
        print(f"{config.chart} drawn")
    apart = replay_answers(config.log / "pictures", load_exported(config.policy)) if config.policy else 0.0
    if config.policy:
        verdict = (
            f"differ by up to {apart:g} rad: this is not the policy that drove" if apart else "are the same to the bit"
        )
        print(f"answers to the recorded pictures {verdict}")
    return int(bool(found.different) or apart > 0)


if __name__ == "__main__":
    run_main(main)
