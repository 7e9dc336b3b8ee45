"""How much of a driver's steering the network finds in the pictures of a recorded drive.

python scripts/evaluate_recording.py --config configs/aerial2ground/recording.yaml --data FOLDER
"""

import json
from pathlib import Path

from rich.progress import Progress

from aerial2ground.evaluate_recording import RecordingConfig, evaluate_recording
from hashnerf.command_line import parse_config, run_main
from hashnerf.transforms_json import write_atomically


def main() -> None:
    """Train on all blocks but one, ask about that one, in turn; print R2 beside two baselines."""
    config = parse_config(RecordingConfig, description="Measure the steering network on a recorded drive.")
    with Progress(transient=True) as progress:
        task = progress.add_task("blocks")
        results = evaluate_recording(config, lambda done, total: progress.update(task, completed=done, total=total))
    print(f"{results['frames']} frames, {results['seconds']} s")
    print(f"{'method':10s}{'R2':>8s}{'error':>8s}   R2 of every held-out block")
    for name in ("network", "linear", "constant"):
        row = results[name]
        blocks = " ".join(f"{value:6.2f}" for value in row["r2_blocks"])
        print(f"{name:10s}{row['r2']:8.3f}{row['mean_absolute_error']:8.3f}   {blocks}")
    if config.out:  # last: what was found has been said, whatever becomes of the file
        write_atomically(Path(config.out), json.dumps(results, indent=1, allow_nan=False).encode())


if __name__ == "__main__":
    run_main(main)
