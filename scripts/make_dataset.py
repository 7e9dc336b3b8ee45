"""Render a scenario of the embedded worlds as a data set folder.

python scripts/make_dataset.py --config configs/worlds/intersection.yaml --out data/intersection
"""

from collections import Counter
from typing import Any

from rich.progress import Progress

from hashnerf.command_line import parse_config, run_main
from worlds.dataset_folder import DatasetConfig, MadeDataset, make_dataset


def main() -> int:
    """Make the data set and print what is in it."""
    config = parse_config(DatasetConfig, description="Render a scenario of the embedded worlds as a data set folder.")
    with Progress(transient=True) as progress:
        task = progress.add_task("cameras")
        made = make_dataset(config, lambda done, total: progress.update(task, completed=done, total=total))
    if not made.rendered:
        print(f"{config.folder}: this data set is there already (same settings, seed and size); nothing to do.")
    _summarise(config, made)
    return 0


def _summarise(config: DatasetConfig, made: MadeDataset) -> None:
    document = made.document
    names = document["branches"]
    states = [f"{names[s['branch']]} {s['step']}{' (hazard)' if s['hazard'] else ''}" for s in document["states"]]
    kinds = Counter(document["camera_kinds"])
    splits = Counter(frame["split"] for frame in document["frames"])
    print(f"{config.folder}: {len(document['frames'])} views of {document['w']} x {document['h']} px")
    print(f"states   {', '.join(states)}")
    print(f"cameras  {', '.join(f'{count} {kind}' for kind, count in kinds.items())}")
    print(f"views    {', '.join(f'{count} {split}' for split, count in splits.items())}")
    for actor, rows in document["visibility"].items():
        if rows:
            print(f"{actor:8s} {_visibility(rows)}")
    print(f"seconds  {made.seconds:.1f}")


def _visibility(rows: list[list[Any]]) -> str:
    """How many views show an actor wholly (over 95 % of its pixels), partly, or not at all."""
    counts = Counter("none" if not seen else "full" if seen > 0.95 * alone else "partial" for *_, seen, alone in rows)
    return ", ".join(f"{counts[kind]} views {kind}" for kind in ("full", "partial", "none"))


if __name__ == "__main__":
    run_main(main)
