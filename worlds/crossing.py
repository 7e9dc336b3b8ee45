"""What the two intersection scenarios share: ego and truck, their routes, the camera rig, the facts for driving.

The ego drives along +x; the truck drives along -y on the crossing road and so comes from the ego's left.
"""

import math
from collections.abc import Sequence

import numpy as np

from hashnerf.cameras import look_at
from worlds.boxes import Pose
from worlds.crossing_street import AREA, EGO_LANE, STOP_LINE, TRUCK_LANE
from worlds.rig import Mount, interleaved_splits, lane_poses, pinholes, ring_poses
from worlds.routes import Size, Traffic, nominal_traffic, straight
from worlds.scene import Actor, Rig, State
from worlds.settings import EgoCameraConfig, SplitConfig
from worlds.vehicles import box_truck, sedan

EGO_SIZE = (4.5, 1.8, 1.42)
EGO_PAINT = (0.03, 0.10, 0.50)
TRUCK_PAINT = (0.75, 0.13, 0.03)
EGO_ROUTE = straight((AREA[0], EGO_LANE), 0.0, AREA[2] - AREA[0])
TRUCK_ROUTE = straight((TRUCK_LANE, AREA[3]), -math.pi / 2, AREA[3] - AREA[1])
LINE = STOP_LINE - AREA[0]
"""Arc length of the stop line on the ego's route."""
EGO_CAMERAS, ELEVATED_CAMERAS = 56, 43


def ego_pose(x: float) -> Pose:
    """The ego in its lane with its centre at `x`."""
    return Pose(x, EGO_LANE, 0.0, 0.0)


def truck_pose(y: float) -> Pose:
    """The truck in its lane with its centre at `y`."""
    return Pose(TRUCK_LANE, y, 0.0, -math.pi / 2)


def crossing_actors(truck_size: Size, jitter: float, rng: np.random.Generator) -> dict[str, Actor]:
    """The ego and the truck; the seed changes the truck's size by up to 3 %."""
    scale = 1.0 - 0.03 * jitter * rng.uniform(0.0, 1.0, 3)
    size = tuple(round(float(side), 3) for side in np.array(truck_size) * scale)
    return {
        "ego": Actor(sedan(EGO_SIZE, EGO_PAINT), EGO_SIZE),
        "truck": Actor(box_truck(size, TRUCK_PAINT), size),
    }


def crossing_mount(camera: EgoCameraConfig) -> Mount:
    """The ego's camera: it turns towards the crossing road over the last metres before the stop line."""
    return Mount(camera.height, -3.0, camera.yaw, camera.pan, LINE - 8.4, LINE - 0.4, camera.field_of_view)


def crossing_rig(
    mount: Mount, ego_x: Sequence[float], start: float, above: tuple[float, float, float], splits: SplitConfig,
    rng: np.random.Generator,
) -> Rig:  # fmt: skip
    """56 cameras on the ego's lane, 43 on a ring, one bird's-eye at `above`."""
    bodies = [x - AREA[0] for x in ego_x]
    poses = lane_poses(EGO_ROUTE, bodies, EGO_SIZE, (start - AREA[0], LINE + 0.5), EGO_CAMERAS, mount, rng)
    # the ring stands around what the bird's-eye sees: ground that only a few pixels cross is never reconstructed
    centre = (above[0], above[1])
    poses += ring_poses(ELEVATED_CAMERAS, centre, (*centre, 0.5), (20.0, 30.0), (13.0, 22.0), rng)
    poses.append(look_at(above, (above[0], above[1], 0.0), (1.0, 0.0, 0.0)))
    kinds = ("ego",) * EGO_CAMERAS + ("elevated",) * ELEVATED_CAMERAS + ("birds_eye",)
    fields = [mount.field_of_view] * EGO_CAMERAS + [68.0] * ELEVATED_CAMERAS + [52.0]
    return Rig(pinholes(poses, fields), kinds, interleaved_splits(kinds, splits.test_every, splits.birds_eye))


def crossing_traffic(states: Sequence[State], truck_size: Size, step_seconds: float) -> Traffic:
    """Routes, conflict zone and the nominal run through the states."""
    return nominal_traffic(
        {"ego": EGO_ROUTE, "truck": TRUCK_ROUTE},
        {"ego": EGO_SIZE, "truck": truck_size},
        [(state.branch, state.step, state.poses) for state in states],
        LINE - EGO_SIZE[0] / 2,
        step_seconds,
    )
