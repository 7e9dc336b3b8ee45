"""What every part of the evaluation reads: a trained run, the pictures it is judged on, and what those pixels allow.

A *view* is one row of `Views`. Two views are equal when their pictures agree to the last bit at one camera: no method
can tell their states apart, so `picture` gives them one number. States are numbers of the `StateTable`. States whose
occupied boxes agree cannot be told apart by probing; `same_boxes` gives them one number too, the first of them, which
is the probe's answer for all.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from carff.beliefs import Belief
from carff.config import CarffConfig
from carff.model import CarffModel, load_carff
from carff.pcvae import Pcvae
from carff.scene_info import scene_info
from carff.stages import load_pcvae, refuse_other_pcvae
from carff.state_style import StateStyle, state_style
from carff.states import StateTable, ambiguous_groups, build_state_table
from hashnerf.capacity import filled_from, is_open
from hashnerf.command_line import config_changes, plain_config
from hashnerf.errors import UserError
from hashnerf.posed_images import PosedImages, load_posed_images

EGO = "ego"
WHOLLY_VISIBLE = 0.95  # share of an actor's pixels from which a view counts as showing all of it
NONE, PARTIAL, FULL, UNSTATED = 0, 1, 2, -1  # the first three index forecast_metrics.VISIBILITY_CLASSES
MISSING_GREY = 200
FROM_THE_RUN = ("pcvae", "nerf", "mdn", "probe", "planner")  # parts of the config that a report cannot change


@dataclass(frozen=True)
class Part:
    """What one part of the evaluation found: results by dotted place, figures as PNG, and reasons for gaps."""

    results: Mapping = field(default_factory=dict)
    figures: Mapping[str, bytes] = field(default_factory=dict)
    not_run: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Views:
    """One row a view."""

    frame: Int[Tensor, " n"]
    state: Int[Tensor, " n"]
    camera: Int[Tensor, " n"]
    picture: Int[Tensor, " n"]
    """One number per distinct picture of one camera."""
    determined: Bool[Tensor, " n"]
    """Whether no other state gives this picture."""
    train: Bool[Tensor, " n"]
    test: Bool[Tensor, " n"]
    ego: Bool[Tensor, " n"]
    """Whether the camera is the driving car's (every camera, where the data set names no kinds)."""
    shows_actor: Bool[Tensor, " n"]
    """Whether a pixel of any actor but the ego's own body is visible."""
    visibility: Int[Tensor, " n"]
    """NONE, PARTIAL or FULL: how much this camera would show of the main actor at this step; UNSTATED."""
    belief: Belief

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, index: Int[Tensor, " m"] | Bool[Tensor, " n"]) -> "Views":
        """The views at `index`."""
        names = [name for name in self.__dataclass_fields__ if name != "belief"]
        return replace(self, **{name: getattr(self, name)[index] for name in names}, belief=self.belief.select(index))


@dataclass(frozen=True)
class BeliefData:
    """A PC-VAE beside the data set that it is judged on."""

    data: PosedImages
    table: StateTable
    groups: Int[Tensor, "states cameras"]
    """Smallest state with the same picture at the camera, -1 without a view."""
    views: Views
    pcvae: Pcvae
    seed: int

    def generator(self, salt: int) -> torch.Generator:
        """A generator that depends on the run's seed and on who asks."""
        return torch.Generator().manual_seed(self.seed * 1009 + salt)


@dataclass(frozen=True)
class EvaluationData:
    """A trained run beside the data set that it is judged on."""

    config: CarffConfig
    data: PosedImages
    table: StateTable
    model: CarffModel
    groups: Int[Tensor, "states cameras"]
    """Smallest state with the same picture at the camera, -1 without a view."""
    views: Views
    style: StateStyle

    @property
    def beliefs(self) -> BeliefData:
        """What the PC-VAE alone is judged by."""
        return BeliefData(self.data, self.table, self.groups, self.views, self.model.pcvae, self.config.seed)

    @property
    def same_boxes(self) -> Int[Tensor, " states"]:
        """The first state with the same occupied boxes as each state."""
        return first_equal(self.model.probe.candidates.occupied)

    def goes_on(self) -> Bool[Tensor, " n"]:
        """Whether each view's state has a next one."""
        return self.table.successor[self.views.state] >= 0

    def branch_share(self) -> Float[Tensor, "states branches"]:
        """How much a probed state speaks for each branch: states with the same boxes share it by their weights."""
        branch = torch.nn.functional.one_hot(self.table.branch, len(self.table.branch_names)).float()
        shared = self.model.probe.candidates.same.float() @ (branch * self.table.branch_weight)
        return shared / shared.sum(dim=1, keepdim=True)

    def pictures_at(self, camera: int) -> UInt8[np.ndarray, "states h w 3"]:
        """The picture of every state at a camera, plain grey where there is none."""
        rows = self.table.views[:, camera]
        pictures = self.data.images[rows.clamp(min=0)].clone()
        pictures[rows < 0] = MISSING_GREY
        return pictures.numpy()

    def generator(self, salt: int) -> torch.Generator:
        """A generator that depends on the run's seed and on who asks."""
        return torch.Generator().manual_seed(self.config.seed * 1009 + salt)


def load_evaluation_data(config: CarffConfig) -> EvaluationData:
    """Loads the run and its data set; raises UserError when a stage is missing or the data is not what it learned."""
    model = load_carff(config.folder)
    if is_open(config.nerf):  # what was derived from the pictures when the field was trained
        config = replace(config, nerf=filled_from(config.nerf, plain_config(model.config.nerf)))
    made, asked = ({key: plain_config(one)[key] for key in FROM_THE_RUN} for one in (model.config, config))
    changes = config_changes(made, asked)
    if changes:
        raise UserError(
            f"{config.folder}: these settings are the trained run's and cannot be changed here ({'; '.join(changes)}); "
            "give the --config and the settings that it was trained with"
        )
    data = load_posed_images(Path(config.dataset), config.image_size or None)
    table = build_state_table(data)
    cameras = model.scene.cameras
    if (table.states, table.camera_kinds) != (model.scene.states, model.scene.camera_kinds):
        raise UserError(f"{config.dataset}: has other states or cameras than the data that {config.folder} learned")
    if (data.cameras.width, data.cameras.height) != (cameras.width, cameras.height):
        raise UserError(
            f"image_size: {config.folder} learned pictures of {cameras.width} x {cameras.height} pixels, "
            f"not {data.cameras.width} x {data.cameras.height}; give the image_size of the training"
        )
    groups = ambiguous_groups(data.images, table.views)
    views = all_views(table, groups, model.encode(data.images))
    return EvaluationData(config, data, table, model, groups, views, state_style(table.states, table.branch_names))


def load_belief_data(config: CarffConfig) -> tuple[BeliefData, dict]:
    """Loads the PC-VAE of a run, whose later stages may be missing, and its data set; also what its training cost.

    Raises UserError where it is not trained, or was trained on other data or with another config.
    """
    data = load_posed_images(Path(config.dataset), config.image_size or None)
    table = build_state_table(data)
    refuse_other_pcvae(config)
    pcvae, cost = load_pcvae(config, scene_info(data, table))
    groups = ambiguous_groups(data.images, table.views)
    views = all_views(table, groups, pcvae.encode(data.images).to("cpu"))
    return BeliefData(data, table, groups, views, pcvae, config.seed), cost


def all_views(table: StateTable, groups: Int[Tensor, "states cameras"], beliefs: Belief) -> Views:
    """Collects all views of a table; `beliefs` has a row per picture of the data set."""
    state, camera = (table.views >= 0).nonzero(as_tuple=True)
    frame = table.views[state, camera]
    group = groups[state, camera]
    picture = group * table.views.shape[1] + camera
    counts = torch.bincount(picture)
    splits = [table.frame_splits[row] for row in frame.tolist()]
    kinds = torch.tensor([kind in (EGO, "unknown") for kind in table.camera_kinds])
    return Views(
        frame=frame,
        state=state,
        camera=camera,
        picture=picture,
        determined=counts[picture] == 1,
        train=torch.tensor([split == "train" for split in splits]),
        test=torch.tensor([split == "test" for split in splits]),
        ego=kinds[camera],
        shows_actor=actor_visible(table)[state, camera],
        visibility=visibility_class(table)[state, camera],
        belief=beliefs.select(frame),
    )


def first_equal(rows: Bool[Tensor, "n m"]) -> Int[Tensor, " n"]:
    """Returns for each row the number of the first row equal to it."""
    return (rows[:, None] == rows[None]).all(dim=-1).float().argmax(dim=1)


def one_label(picture: Int[Tensor, " n"], label: Int[Tensor, " n"]) -> Bool[Tensor, " n"]:
    """Returns for each row whether its picture comes with one label only."""
    size = int(picture.max()) + 1 if len(picture) else 0
    low = torch.full((size,), int(label.max()) + 1 if len(label) else 0).scatter_reduce(0, picture, label, "amin")
    high = torch.full((size,), -1).scatter_reduce(0, picture, label, "amax")
    return (low == high)[picture]


def actor_visible(table: StateTable) -> Bool[Tensor, "states cameras"]:
    """Returns where at least one pixel of an actor other than the ego's own body is visible."""
    others = [number for number, name in enumerate(table.actor_names) if name != EGO]
    return (table.visible_px[:, :, others] > 0).any(dim=2)


def main_actor(table: StateTable) -> str | None:
    """Returns the actor that makes the states differ most: the one whose boxes differ in most pairs of states.

    With several branches only pairs of the same step count: what all branches share says nothing about the branch. The
    ego's own body never counts; None where there is no other actor.
    """
    step = torch.tensor([step for _, step in table.states])
    compared = table.branch[:, None] != table.branch[None]
    if compared.any():
        compared &= step[:, None] == step[None]
    else:
        compared = step[:, None] != step[None]
    best, most = None, -1
    for name in table.actor_names:
        boxes = [tuple(box for box in boxes if box.name == name) for boxes in table.actors]
        differ = torch.tensor([[a != b for b in boxes] for a in boxes])
        count = int((differ & compared).sum())
        if name != EGO and count > most:
            best, most = name, count
    return best


def visibility_class(table: StateTable) -> Int[Tensor, "states cameras"]:
    """Returns how much of the main actor each camera would show at each step: NONE, PARTIAL or FULL; UNSTATED.

    The class is that of the branch in which the camera shows most, for all branches of the step alike: a view of an
    empty junction tells as much as the view in which the truck stands there.
    """
    name = main_actor(table)
    if name is None:
        return torch.full(table.views.shape, UNSTATED)
    step = torch.tensor([step for _, step in table.states])
    # [state, other state, camera]: the other state's views that say what the camera shows at the state's step
    beside = (step[:, None] == step[None])[:, :, None] & (table.views >= 0)[None]
    fraction = table.visible_fraction(name)[None]
    best = fraction.masked_fill(~beside, 0.0).amax(dim=1)
    unstated = (beside & (fraction < 0)).any(dim=1)
    level = (best > 0).long() + (best > WHOLLY_VISIBLE).long()
    return level.masked_fill(unstated, UNSTATED)
