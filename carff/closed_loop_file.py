"""closed_loop.json in a run folder: episodes and decisions along the approach, or why there are none.

The file is all that the report knows of the embedded worlds.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from carff.planning_metrics import ApproachPoint, Episode
from hashnerf.errors import UserError
from hashnerf.transforms_json import read_transforms, write_atomically

CLOSED_LOOP = "closed_loop.json"


@dataclass(frozen=True)
class ClosedLoop:
    """Episodes of all policies, decisions along the approach, how they were made, or the reason why there are none."""

    episodes: tuple[Episode, ...] = ()
    approach: tuple[ApproachPoint, ...] = ()
    about: dict | None = None
    """Number of samples, seed, seconds and driving settings."""
    reason: str = ""


def save_closed_loop(folder: Path, recorded: ClosedLoop) -> None:
    """Replaces the file as a whole."""
    write_atomically(folder / CLOSED_LOOP, json.dumps(asdict(recorded), indent=1, allow_nan=False).encode())


def load_closed_loop(folder: Path) -> ClosedLoop:
    """Reads the file; without one the reason names the command that writes it. Raises UserError for a foreign file."""
    path = folder / CLOSED_LOOP
    if not path.is_file():
        return ClosedLoop(reason=f"not driven yet: run scripts/plan_carla.py --run {folder}")
    plain = read_transforms(path)
    try:
        episodes = tuple(Episode(**entry) for entry in plain["episodes"])
        approach = tuple(ApproachPoint(**entry) for entry in plain["approach"])
        return ClosedLoop(episodes, approach, plain["about"], plain["reason"])
    except (KeyError, TypeError) as error:
        raise UserError(f"{path}: not written by scripts/plan_carla.py ({error}); run it again") from error
