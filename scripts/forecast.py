"""One picture in: belief, sampled futures with their probabilities, and pictures of them out.

python scripts/forecast.py --run runs/intersection_fast --image ANY.png --out forecast/
"""

from dataclasses import dataclass
from pathlib import Path

from carff.forecast_files import forecast_image
from carff.model import load_carff
from hashnerf.command_line import parse_config, run_main, set_threads


@dataclass(frozen=True)
class ForecastConfig:
    """Forecast from one picture."""

    run: str
    """Folder of a trained run."""
    image: str
    """Picture to forecast from: any file of the aspect ratio that the run was trained on; it is resized."""
    out: str = "forecast"
    """Folder for forecast.json and the rendered futures."""
    samples: int = 10
    """Sampled futures."""
    ahead: int = 1
    """Steps to look ahead."""
    camera: int = -1
    """Camera number to render from besides the bird's-eye view; -1 takes the first ego camera."""
    seed: int = 0
    """Seed of the samples."""
    threads: int = 0
    """Processor threads; 0 uses all cores."""


def main() -> None:
    """Load the run, forecast, and print what is expected."""
    config = parse_config(ForecastConfig, description="Forecast the next steps from one picture.")
    set_threads(config.threads)
    model = load_carff(Path(config.run))
    result = forecast_image(
        model, Path(config.image), Path(config.out), config.samples, config.ahead, config.camera, config.seed
    )
    for line in result.summary:
        print(line)


if __name__ == "__main__":
    run_main(main)
