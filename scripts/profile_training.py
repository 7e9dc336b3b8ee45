"""Profile the training of a radiance field, part by part and kernel by kernel, in a run of its own.

Writes the pipeline's section of docs/results/profile.md.

python scripts/profile_training.py aerial2ground --config configs/aerial2ground/fast.yaml --reconstruction.steps 60
python scripts/profile_training.py carff --config configs/carff/fast.yaml --nerf.steps 60      # after train_pcvae.py
"""

import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

from aerial2ground.config import AerialConfig
from aerial2ground.stages import run_reconstruction
from carff.config import CarffConfig
from carff.stages import run_nerf
from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError
from hashnerf.results_page import table_lines
from hashnerf.run_info import commit, machine
from hashnerf.step_profile import kernels_table, parts_table, profile_training

PIPELINES = {"aerial2ground": (AerialConfig, run_reconstruction), "carff": (CarffConfig, run_nerf)}
PAGE = Path("docs/results/profile.md")
HEAD = "# Where the time of a training goes\n\nShares count: the profiler itself costs time.\n"


def main() -> None:
    """Profile and append to the page."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name in ("-h", "--help"):
        print(f"{__doc__}\nEach answers --help.")
        return
    if name not in PIPELINES:
        raise UserError(f"{name or 'nothing'}: is no pipeline; say scripts/profile_training.py {'|'.join(PIPELINES)}")
    config_class, train = PIPELINES[name]
    config = parse_config(config_class, sys.argv[2:], description="Profile the training of a radiance field.")
    own = replace(config, name=f"{config.name}_profile", overwrite=True)
    if (config.folder / "pcvae").is_dir():
        shutil.copytree(config.folder / "pcvae", own.folder / "pcvae", dirs_exist_ok=True)
    found = profile_training(lambda: train(own))
    command = shlex.join(["python", "scripts/profile_training.py", *sys.argv[1:]])
    lines = [f"\n## {name}, {found.steps} steps\n", f"`{command}`; seed {config.seed}; {machine()}; {commit()}.\n"]
    lines += [*table_lines(parts_table(found)), "", *table_lines(kernels_table(found))]
    sections = PAGE.read_text(encoding="utf-8").split("\n## ") if PAGE.is_file() else [HEAD]
    kept = [part for part in sections if not part.startswith(f"{name},")]
    PAGE.write_text("\n## ".join(kept) + "\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    run_main(main)
