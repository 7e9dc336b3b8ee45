"""Everything, from nothing to a report: data set, three trainings, closed-loop driving, evaluation.

python scripts/demo.py --config configs/carff/fast.yaml
python scripts/demo.py --config configs/carff/fast.yaml --config configs/carff/two_lane_merge.yaml

If `configs/worlds/<name of the data-set folder>.yaml` exists, that embedded world is rendered first and driven in
closed loop; otherwise the data set is taken as it is. Interrupted? The same command continues.
"""

import sys
from pathlib import Path

from carff.config import CarffConfig
from hashnerf.command_line import parse_config, run_main
from hashnerf.pipeline import check_script_folder, run_stage

SCRIPTS = Path(__file__).resolve().parent


def main() -> None:
    """Run the stages in order."""
    arguments = sys.argv[1:]
    config = parse_config(CarffConfig, arguments, description="Run the whole CARFF pipeline and write its report.")
    check_script_folder(SCRIPTS, "train_pcvae.py")
    world = SCRIPTS.parent / "configs" / "worlds" / f"{Path(config.dataset).name}.yaml"

    def stage(name: str, script: str, *options: str) -> None:
        run_stage(name, [str(SCRIPTS / script), *options], config.folder)

    if world.is_file():
        stage("data set", "make_dataset.py", "--config", str(world), "--out", config.dataset)
    stage("PC-VAE", "train_pcvae.py", *arguments)
    stage("radiance field", "train_nerf.py", *arguments)
    stage("forecast", "train_mdn.py", *arguments)
    if world.is_file():
        stage("closed loop", "plan_carla.py", *arguments)
    stage("evaluation", "evaluate_carff.py", *arguments)
    print(f"\nDone. Open {config.folder / 'report.html'} in a browser.")


if __name__ == "__main__":
    run_main(main)
