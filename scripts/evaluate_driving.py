"""Stage 4 of aerial2ground: the networks drive in the town as it is now and tell where the car is (Tables II and I).

python scripts/evaluate_driving.py --config configs/aerial2ground/fast.yaml
"""

from dataclasses import dataclass

from aerial2ground.config import AerialConfig
from aerial2ground.evaluation_stages import run_driving, run_localisation
from hashnerf.command_line import parse_config, run_main


@dataclass(frozen=True)
class EvaluationConfig(AerialConfig):
    """The pipeline's config, and what to evaluate."""

    driving: bool = True
    """Let the steering networks drive (Table II)."""
    locating: bool = True
    """Let the other networks tell poses (Table I)."""


def main() -> None:
    """Evaluate, print the tables and keep them in the run's folder."""
    config = parse_config(EvaluationConfig, description="Try the learned networks in the deployment town.")
    if config.driving:
        print(f"{'trajectory':14s}{'method':10s}{'position':>10s}{'yaw':>10s}{'interventions':>16s}")
        for trajectory, rows in run_driving(config).items():
            for method, row in rows.items():
                place = f"{row['pos_m']:.3f} m"
                print(
                    f"{trajectory:14s}{method:10s}{place:>10s}{row['yaw_deg']:>6.1f} deg{row['interventions']:>16.1f}"
                )
    if config.locating:
        print(f"{'localisation':24s}{'position':>10s}{'yaw':>10s}")
        for method, row in run_localisation(config).items():
            print(f"{method:24s}{row['pos_m']:8.3f} m{row['yaw_deg']:6.1f} deg")


if __name__ == "__main__":
    run_main(main)
