"""closed_loop.json in a run folder: the episodes that were driven, or why none could be.

The file is all that the report knows of the embedded worlds.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from carff.planning_metrics import Episode
from hashnerf.errors import UserError
from hashnerf.transforms_json import read_transforms, write_atomically

CLOSED_LOOP = "closed_loop.json"


@dataclass(frozen=True)
class ClosedLoop:
    """Episodes of all policies and how they were driven, or the reason why there are none."""

    episodes: tuple[Episode, ...] = ()
    about: dict | None = None
    """Number of samples, seed, seconds and driving settings."""
    reason: str = ""


def save_closed_loop(folder: Path, episodes: Sequence[Episode], about: dict, reason: str = "") -> None:
    """Replaces the file as a whole."""
    plain = {"about": about, "reason": reason, "episodes": [asdict(episode) for episode in episodes]}
    write_atomically(folder / CLOSED_LOOP, json.dumps(plain, indent=1, allow_nan=False).encode())


def load_closed_loop(folder: Path) -> ClosedLoop:
    """Reads the file; without one the reason names the command that writes it. Raises UserError for a foreign file."""
    path = folder / CLOSED_LOOP
    if not path.is_file():
        return ClosedLoop(reason=f"not driven yet: run scripts/plan_carla.py --run {folder}")
    plain = read_transforms(path)
    try:
        episodes = tuple(Episode(**entry) for entry in plain["episodes"])
        return ClosedLoop(episodes, plain["about"], plain["reason"])
    except (KeyError, TypeError) as error:
        raise UserError(f"{path}: not written by scripts/plan_carla.py ({error}); run it again") from error
