"""From a drone's pictures of a town to policies that drive in it, and a report: everything of aerial2ground in order.

python scripts/demo_aerial.py --config configs/aerial2ground/fast.yaml

The embedded mini-city is surveyed, reconstructed, learned from and driven in; other arrangements of its houses serve
Table I. Stages that do not need each other run side by side. Interrupted? The same command continues.
"""

import sys
from pathlib import Path

from aerial2ground.config import AerialConfig, layout_config
from aerial2ground.report import write_run_report
from aerial2ground.report_results import ablation_folder
from aerial2ground.road_prior import VARIANTS
from hashnerf.command_line import parse_config, run_main, usable_cores
from hashnerf.pipeline import check_script_folder, run_stage, run_stages_together

SCRIPTS = Path(__file__).resolve().parent
WORLD = SCRIPTS.parent / "configs" / "worlds" / "mini_city.yaml"


def main() -> None:
    """Run the stages."""
    arguments = sys.argv[1:]
    shown = " ".join(["python scripts/demo_aerial.py", *arguments])
    config = parse_config(AerialConfig, arguments, description="Run all of aerial2ground and write its report.")
    check_script_folder(SCRIPTS, "train_road_nerf.py")
    towns = [layout_config(config, number) for number in range(config.evaluation.layouts)]
    cores = usable_cores()

    def command(script: str, *options: str, town: AerialConfig = config) -> list[str]:
        place = ["--name", town.name, "--dataset", town.dataset]
        return [str(SCRIPTS / f"{script}.py"), *arguments, *place, *options]

    def together(phase: str, *stages: tuple[str, list[str]]) -> None:
        run_stages_together(stages, config.folder, cores, phase)

    def each(script: str, *options: str) -> list[tuple[str, list[str]]]:
        return [(f"{script} {town.name}", command(script, *options, town=town)) for town in towns]

    def survey(number: int, town: AerialConfig) -> tuple[str, list[str]]:
        options = ["--config", str(WORLD), "--mini_city.layout", str(number), "--out", town.dataset, "--workers", "1"]
        return f"survey of {town.name}", [str(SCRIPTS / "make_dataset.py"), *options]

    together("drone surveys", *(survey(number, town) for number, town in enumerate(towns)))
    together("collected drives", *each("collect_drives", "--workers", "1"))
    short = ("--reconstruction.steps", str(config.evaluation.layout_steps))
    fields = [("field", command("train_road_nerf"))]
    fields += [(f"field of {town.name}", command("train_road_nerf", *short, town=town)) for town in towns[1:]]
    tries = ("--reconstruction.steps", str(config.evaluation.ablation_steps))
    ablation = {
        name: ("--name", str(ablation_folder(Path(config.name), name)), *tries, *options)
        for name, options in VARIANTS.items()
    }
    fields += [(f"field with prior {name}", command("train_road_nerf", *o)) for name, o in ablation.items()]
    fields += [("field of collected pictures", command("train_road_nerf", "--pictures", "drives"))]
    together("radiance fields", *fields)
    views = each("make_ground_views", "--workers", "1")
    views += [("views of collected pictures", command("make_ground_views", "--workers", "1", "--pictures", "drives"))]
    views += [("field's figures", command("evaluate_reconstruction"))]
    views += [
        (f"figures with prior {name}", command("evaluate_reconstruction", "--aerial", "false", *options))
        for name, options in ablation.items()
    ]
    together("views and their figures", *views)
    run_stage("steering networks", command("train_policy"), config.folder)
    for town in towns:
        run_stage(f"localisers of {town.name}", command("train_localizer", town=town), config.folder)
    run_stage("drives and localisation", command("evaluate_driving"), config.folder)
    for town in towns[1:]:
        run_stage(
            f"localisation in {town.name}", command("evaluate_driving", "--driving", "false", town=town), config.folder
        )
    print(f"\nDone. Open {write_run_report(config, shown)} in a browser.")


if __name__ == "__main__":
    run_main(main)
