"""Steering networks of a run become ONNX files that a car reads without torch, each tried against torch.

python scripts/export_policy.py --config configs/aerial2ground/fast.yaml
"""

from dataclasses import dataclass

from aerial2ground.config import AerialConfig
from aerial2ground.exported_policy import load_exported
from aerial2ground.latency import latency_ms
from aerial2ground.policy_export import export_trained, extreme_pictures, trained_folders
from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError


@dataclass(frozen=True)
class ExportConfig(AerialConfig):
    """The pipeline's config, and how long to time."""

    frames: int = 500
    """Pictures timed with every file, on one thread; 0 times none."""

    def __post_init__(self):
        super().__post_init__()
        if self.frames < 0:
            raise UserError(f"frames is {self.frames}; give 0 or more")


def main() -> None:
    """Export every trained network, and print size, difference from torch and speed."""
    config = parse_config(ExportConfig, description="Export the trained steering networks as ONNX files.")
    for folder in trained_folders(config.folder / "policies"):
        export = export_trained(folder, config)
        line = f"{export.path}: {export.size / 1024:.0f} kB, differs from torch by at most {export.parity:.1e} rad"
        if config.frames:
            policy = load_exported(export.path)
            took = latency_ms(policy, extreme_pictures(policy.info.shape)[-1], config.frames)
            line += f", {took.median:.2f} ms a picture (99 of 100 within {took.p99:.2f} ms)"
        print(line)


if __name__ == "__main__":
    run_main(main)
