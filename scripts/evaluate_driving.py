"""Stage 4 of aerial2ground: the networks drive in the town as it is now, beside the expert that taught them.

python scripts/evaluate_driving.py --config configs/aerial2ground/fast.yaml
"""

from dataclasses import dataclass

from aerial2ground.config import AerialConfig
from aerial2ground.stages import run_driving
from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError


@dataclass(frozen=True)
class DrivingConfig(AerialConfig):
    """The pipeline's config, and how often to drive."""

    trials: int = 2
    """Drives of every method on every trajectory, each with a start and a noise of its own."""

    def __post_init__(self):
        if self.trials < 1:
            raise UserError(f"trials is {self.trials}; give at least 1")


def main() -> None:
    """Drive and print Table II."""
    config = parse_config(DrivingConfig, description="Drive the learned policies in the deployment town.")
    table = run_driving(config, range(config.trials))
    print(f"{'trajectory':14s}{'method':10s}{'position':>10s}{'yaw':>10s}{'interventions':>16s}")
    for trajectory, rows in table.items():
        for method, row in rows.items():
            place = f"{row['pos_m']:.3f} m"
            print(f"{trajectory:14s}{method:10s}{place:>10s}{row['yaw_deg']:>6.1f} deg{row['interventions']:>16.1f}")


if __name__ == "__main__":
    run_main(main)
