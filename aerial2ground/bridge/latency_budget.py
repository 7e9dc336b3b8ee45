"""Where the time goes from a picture to the bytes that answer it, of a drive on the rig (milliseconds).

Every picture has the CRC of its own; the black box holds every command with the CRC of its picture, when it was taken,
sent and heard, and every period's bytes; the fake controller says when they arrived.
"""

import bisect
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from aerial2ground.bridge.wire import Received
from aerial2ground.guard.messages import unpack
from aerial2ground.guard.vesc import SET_SERVO
from hashnerf.errors import UserError

STAGES = (
    "camera: compress, network, decode",
    "policy: rectify, network, low-pass",
    "socket to the guard",
    "guard: until its next period",
    "write, until the controller has read",
    "all of it",
)


def stage_times(
    records: Sequence[Mapping], shown: Mapping[int, float], received: Sequence[Received]
) -> Float[np.ndarray, "pictures stages"]:
    """Returns for every picture that was steered by how long each of STAGES took, in milliseconds.

    `shown` says when a picture was taken, by its CRC. Only the first command of a picture counts.
    """
    arrivals = [one.time for one in received if one.kind == SET_SERVO]
    rows, seen = [], set()
    for record in records:
        for heard, kind, value in record.get("in", ()):
            command = unpack(bytes.fromhex(value)) if kind == "message" else None
            if command is None or command.picture in seen or command.picture not in shown or not record["out"]:
                continue
            seen.add(command.picture)
            arrival = bisect.bisect_left(arrivals, record["t"])
            if 0 < arrival < len(arrivals):  # neither before nor after what was received
                moments = [shown[command.picture], command.taken, command.sent, heard, record["t"], arrivals[arrival]]
                rows.append([*np.diff(moments), moments[-1] - moments[0]])
    return 1000 * np.array(rows).reshape(-1, len(STAGES))


def budget(times: Float[np.ndarray, "pictures stages"]) -> list[tuple[str, float, float]]:
    """Returns stage, median and 99th percentile (ms); raises UserError where nothing was measured."""
    if not len(times):
        raise UserError("no picture of the log is one that was shown; let the bridge drive on the rig")
    return [
        (stage, float(np.median(column)), float(np.percentile(column, 99)))
        for stage, column in zip(STAGES, times.T, strict=True)
    ]
