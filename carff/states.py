"""The states of a data set: which (branch, step) pairs there are, which view shows them, and what is true in each.

A *state* is a (branch, step) pair; states are numbered in sorted order. A *view* is the picture of a state from a
camera, kept as a row number of the data set, -1 where there is none. Boxes are in world metres, yaw in radians.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from hashnerf.errors import DataError, UserError
from hashnerf.posed_images import Frame, PosedImages

POSE_TOLERANCE = 1e-4  # metres and unit-vector components: rounding in a text file, not a camera that moved
UNKNOWN_PIXELS = -1


@dataclass(frozen=True)
class ActorBox:
    """Where an actor's bounding box stands: centre and size (length, width, height) in metres, yaw in radians."""

    name: str
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float


@dataclass(frozen=True)
class StateTable:
    """The states of a data set and everything that is known about them."""

    states: tuple[tuple[int, int], ...]
    views: Int[Tensor, "states cameras"]
    successor: Int[Tensor, " states"]
    frame_splits: tuple[str, ...]
    camera_poses: Float[Tensor, "cameras 4 4"]
    camera_kinds: tuple[str, ...]
    branch_names: tuple[str, ...]
    branch_weight: Float[Tensor, " branches"]
    """How often each branch happens; sums to 1."""
    hazard: Bool[Tensor, " states"] | None
    actor_names: tuple[str, ...]
    actors: tuple[tuple[ActorBox, ...], ...]
    visible_px: Int[Tensor, "states cameras actors"]
    unoccluded_px: Int[Tensor, "states cameras actors"]

    def __len__(self) -> int:
        return len(self.states)

    @property
    def branch(self) -> Int[Tensor, " states"]:
        """The branch of each state."""
        return torch.tensor([branch for branch, _ in self.states])

    def index(self, branch: int, step: int) -> int:
        """Returns the number of a state; raises UserError if the data set has no such state."""
        if (branch, step) not in self.states:
            raise UserError(f"no state at branch {branch}, step {step}; the data set has {_listed(self.states)}")
        return self.states.index((branch, step))

    def view_index(self, split: str | None = None) -> Int[Tensor, "states cameras"]:
        """Returns the rows of the views, -1 where missing or outside the split (train, val, test; None = all)."""
        if split is None:
            return self.views
        inside = torch.tensor([name == split for name in self.frame_splits])
        return torch.where(inside[self.views], self.views, -1)  # a missing view stays -1 whatever row -1 says

    def transitions(self) -> Int[Tensor, "pairs 2"]:
        """Returns (state, next state) of every step forward; raises UserError if no branch has two steps."""
        source = (self.successor >= 0).nonzero()[:, 0]
        if len(source) == 0:
            raise UserError("every branch has a single step: a forecast needs data with two steps or more")
        return torch.stack([source, self.successor[source]], dim=1)

    def known_hazard(self) -> Bool[Tensor, " states"]:
        """Returns the hazard flags; raises UserError where the data set does not state them for every state."""
        if self.hazard is None:
            raise UserError(
                "transforms.json does not say which states are hazards: add `hazard` to each entry of `states`"
            )
        return self.hazard

    def actor_index(self, name: str) -> int:
        """Returns the number of an actor; raises UserError for an unknown name."""
        if name not in self.actor_names:
            raise UserError(f"no actor named {name!r}; the data set has {', '.join(self.actor_names) or 'no actors'}")
        return self.actor_names.index(name)

    def visible_fraction(self, name: str) -> Float[Tensor, "states cameras"]:
        """Returns the share of the actor's unoccluded pixels that each view shows: 0 where absent, -1 where unknown."""
        actor = self.actor_index(name)
        visible, unoccluded = self.visible_px[:, :, actor], self.unoccluded_px[:, :, actor]
        return torch.where(visible < 0, -1.0, visible / unoccluded.clamp(min=1))


def build_state_table(posed: PosedImages) -> StateTable:
    """Builds the table of a whole data set (all splits); raises DataError with every problem at once."""
    states = tuple(sorted({(frame.branch, frame.step) for frame in posed.frames}))
    if not states:
        raise UserError(f"{posed.folder}: the data set has no views")
    number = {state: i for i, state in enumerate(states)}
    cameras = 1 + max(frame.camera for frame in posed.frames)
    views, problems = _views(posed.frames, number, cameras)
    poses, pose_problems = _camera_poses(posed, views)
    successor, step_problems = _successors(states)
    hazard, hazard_problems = _hazard(posed.extras, number)
    problems = problems + pose_problems + step_problems + hazard_problems
    if problems:
        raise DataError(str(posed.folder), problems)
    names = tuple(sorted(posed.extras.get("actors") or {}))
    actors = _actors(posed.extras, number, names)
    visible, unoccluded = _visibility(posed.extras, number, names, actors, cameras)
    branches = 1 + max(branch for branch, _ in states)
    branch_names = tuple(posed.extras.get("branches") or [f"branch {i}" for i in range(branches)])
    weight = torch.zeros(len(branch_names))  # a name without frames has no weight
    weight[:branches] = torch.tensor(posed.extras.get("branch_weights") or [1.0] * branches)
    weight[[branch not in {b for b, _ in states} for branch in range(len(branch_names))]] = 0
    return StateTable(
        states=states,
        views=views,
        successor=successor,
        frame_splits=tuple(frame.split for frame in posed.frames),
        camera_poses=poses,
        camera_kinds=tuple((posed.extras.get("camera_kinds") or ["unknown"] * cameras)[:cameras]),
        branch_names=branch_names,
        branch_weight=weight / weight.sum(),
        hazard=hazard,
        actor_names=names,
        actors=actors,
        visible_px=visible,
        unoccluded_px=unoccluded,
    )


def _views(
    frames: tuple[Frame, ...], number: dict[tuple[int, int], int], cameras: int
) -> tuple[Int[Tensor, "states cameras"], list[str]]:
    views = torch.full((len(number), cameras), -1)
    problems = []
    for row, frame in enumerate(frames):
        state = number[frame.branch, frame.step]
        if views[state, frame.camera] >= 0:
            first = frames[int(views[state, frame.camera])].file_path
            problems.append(
                f"{first} and {frame.file_path} are both branch {frame.branch} step {frame.step} camera {frame.camera}"
            )
        views[state, frame.camera] = row
    missing = (views < 0).all(dim=0).nonzero()[:, 0].tolist()
    if missing:
        problems.append(f"cameras {_listed(missing)} have no view: number the cameras 0, 1, 2, ... and use all splits")
    return views, problems


def _camera_poses(
    posed: PosedImages, views: Int[Tensor, "states cameras"]
) -> tuple[Float[Tensor, "cameras 4 4"], list[str]]:
    """Returns one pose a camera: a camera that moves between states would be another camera in each of them."""
    first = views.amax(dim=0).clamp(min=0)
    poses = posed.cameras.pose[first]
    camera = torch.tensor([frame.camera for frame in posed.frames])
    shift = (posed.cameras.pose - poses[camera]).abs().flatten(1).amax(dim=1)
    moved = camera[shift > POSE_TOLERANCE].unique().tolist()
    advice = "give every pose its own camera number"
    return poses, [f"cameras {_listed(moved)} have different poses in different states: {advice}"] if moved else []


def _successors(states: tuple[tuple[int, int], ...]) -> tuple[Int[Tensor, " states"], list[str]]:
    """Returns the next state of the same branch, -1 at its end; one forecast is one step, so steps must be even."""
    successor = torch.full((len(states),), -1)
    for i, ((branch, _), (next_branch, _)) in enumerate(pairwise(states)):
        if branch == next_branch:
            successor[i] = i + 1
    gaps = {states[i + 1][1] - states[i][1]: states[i] for i in (successor >= 0).nonzero()[:, 0].tolist()}
    if len(gaps) <= 1:
        return successor, []
    examples = ", ".join(f"{gap} after branch {b} step {s}" for gap, (b, s) in sorted(gaps.items()))
    return successor, [f"steps are unevenly spaced ({examples}): a forecast goes one equal step at a time"]


def _hazard(extras: dict, number: dict[tuple[int, int], int]) -> tuple[Bool[Tensor, " states"] | None, list[str]]:
    entries = extras.get("states") or []
    listed = {(entry["branch"], entry["step"]): entry.get("hazard") for entry in entries}
    unseen = sorted(set(listed) - set(number))
    problems = [f"states {_listed(unseen)} (branch, step) have no view"] if unseen else []
    flags = [listed.get(state) for state in number]
    return None if None in flags else torch.tensor(flags, dtype=torch.bool), problems


def _actors(
    extras: dict, number: dict[tuple[int, int], int], names: tuple[str, ...]
) -> tuple[tuple[ActorBox, ...], ...]:
    boxes: list[list[ActorBox]] = [[] for _ in number]
    for name in names:
        for entry in extras["actors"][name]:
            state = number[entry["branch"], entry["step"]]
            box = ActorBox(
                name, tuple(map(float, entry["center"])), tuple(map(float, entry["size"])), float(entry["yaw"])
            )
            boxes[state].append(box)
    return tuple(map(tuple, boxes))


def _visibility(
    extras: dict,
    number: dict[tuple[int, int], int],
    names: tuple[str, ...],
    actors: tuple[tuple[ActorBox, ...], ...],
    cameras: int,
) -> tuple[Int[Tensor, "states cameras actors"], Int[Tensor, "states cameras actors"]]:
    """Returns visible and unoccluded pixels: 0 where the actor is absent, -1 where it is there but nothing is said."""
    visible = torch.zeros(len(number), cameras, len(names), dtype=torch.int64)
    unoccluded = torch.zeros_like(visible)
    for state, boxes in enumerate(actors):
        for box in boxes:
            visible[state, :, names.index(box.name)] = UNKNOWN_PIXELS
            unoccluded[state, :, names.index(box.name)] = UNKNOWN_PIXELS
    table = extras.get("visibility") or {}
    for actor, name in enumerate(names):
        for branch, step, camera, seen, whole in table.get(name, ()):
            visible[number[branch, step], camera, actor] = seen
            unoccluded[number[branch, step], camera, actor] = whole
    return visible, unoccluded


def _listed(items: list | tuple, most: int = 8) -> str:
    shown = ", ".join(map(str, items[:most]))
    return shown if len(items) <= most else f"{shown}, ... ({len(items)} in all)"


def connected_groups(same: Bool[Tensor, "n n"]) -> Int[Tensor, " n"]:
    """Returns for each item the smallest number in its group; items are grouped through any chain of `same` pairs."""
    count = len(same)
    group = torch.arange(count, device=same.device)
    linked = same | same.T | torch.eye(count, dtype=torch.bool, device=same.device)
    for _ in range(count):
        group = torch.where(linked, group[None], count).amin(dim=1)
    return group


def ambiguous_groups(
    images: UInt8[Tensor, "n h w 3"], views: Int[Tensor, "states cameras"], tolerance: int = 0
) -> Int[Tensor, "states cameras"]:
    """Returns, camera by camera, groups of states with equal pictures: the group's smallest state, -1 without a view.

    Pictures are equal when no channel of any pixel differs by more than `tolerance` levels (also through a chain).
    """
    groups = torch.full_like(views, -1)
    for camera in range(views.shape[1]):
        states = (views[:, camera] >= 0).nonzero()[:, 0]
        if len(states) == 0:
            continue
        pictures = images[views[states, camera]].to(torch.int16).flatten(1)
        same = torch.stack([(pictures - picture).abs().amax(dim=1) <= tolerance for picture in pictures])
        groups[states, camera] = states[connected_groups(same)]
    return groups


def group_sizes(groups: Int[Tensor, "states cameras"]) -> Int[Tensor, "states cameras"]:
    """Returns the number of states in each view's group; 0 where there is no view."""
    equal = (groups[:, None] == groups[None]) & (groups >= 0)[None]
    return equal.sum(dim=1)


def state_chances(
    groups: Int[Tensor, "states cameras"], weight: Float[Tensor, " states"]
) -> Float[Tensor, "states cameras states"]:
    """Returns how probable each state is given a view's picture: states with equal pictures share it by `weight`.

    Zero everywhere without a view.
    """
    equal = (groups[:, :, None] == groups.T[None]) & (groups >= 0)[:, :, None]
    shared = equal * weight
    return shared / shared.sum(dim=-1, keepdim=True).clamp(min=1e-30)


def state_ceiling(groups: Int[Tensor, "states cameras"]) -> float:
    """Returns the best possible accuracy of naming a view's state from its picture and camera.

    Of states with equal pictures only one can be named, so a view in a group of m counts 1/m.
    """
    sizes = group_sizes(groups)
    sizes = sizes[sizes > 0]
    if len(sizes) == 0:
        raise UserError("the ceiling of state classification needs at least one view")
    return float((1 / sizes.double()).mean())


def determined(groups: Int[Tensor, "states cameras"]) -> Bool[Tensor, "states cameras"]:
    """Returns where a view's picture belongs to one state only."""
    return group_sizes(groups) == 1


def branch_ambiguous(
    groups: Int[Tensor, "states cameras"], branch: Int[Tensor, " states"]
) -> Bool[Tensor, "states cameras"]:
    """Returns where a state of another branch looks exactly the same from the same camera."""
    equal = (groups[:, None] == groups[None]) & (groups >= 0)[None]
    other = branch[:, None] != branch[None]
    return (equal & other[:, :, None]).any(dim=1)
