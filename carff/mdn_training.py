"""Stage 2: training the forecast (CARFF 3.2, B.2; Eq. 6 with samples of the encoder's posterior of the next state).

Trained by likelihood alone, a mixture often ends as one broad Gaussian with the whole weight: whichever component is a
little wider at first claims all samples, and the others get no gradient. So the first `split_share` of the steps leave
weights and sigmas out of the question who explains what. A target belongs to a component by distance alone, softened by
a temperature that falls from far above the spread of the targets to the width of a posterior (deterministic annealing).
Hot, all components follow the same mean of what may come next; cooling, they part by themselves along the direction in
which a source's targets really differ. No branch label is used. Then plain likelihood takes over.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from carff.mdn import MDN
from carff.mixtures import GaussianMixture, negative_log_likelihood
from carff.schedules import cosine_rate
from carff.transitions import TransitionBatch, TransitionConfig, TransitionSampler
from hashnerf.errors import UserError
from hashnerf.finite_steps import FiniteSteps
from hashnerf.low_precision import without_autocast
from hashnerf.model_files import save_model
from hashnerf.training_run import TrainingRun

WARM_UP = 50  # steps: at full rate from the start, most ReLU units die in the first few
FIRST_TEMPERATURE = 4.0  # times the largest variance of the targets: hot enough for one shared mean to form first
NUDGE = 0.2  # of the temperature's length: equal components would stay equal, and tiny differences grow too slowly


@dataclass(frozen=True)
class MdnConfig:
    """The forecast network and its training (CARFF B.2)."""

    components: int = 2
    """Gaussians in the mixture (paper: 2)."""
    width: int = 512
    """Units of every hidden layer (paper: 512)."""
    trunk_layers: int = 2
    """Hidden layers shared by the heads (paper: 2)."""
    head_layers: int = 2
    """Layers of each head (paper: 2)."""
    steps: int = 800
    """Training steps (paper: 30,000)."""
    batch_size: int = 128
    """Pairs of views per step (paper: 128)."""
    lr: float = 0.005
    """Learning rate of Adam at the start (paper: 0.005); it falls along a cosine."""
    final_lr: float = 0.00005
    """Learning rate at the end."""
    split_share: float = 0.6
    """Share of the steps in which components are drawn apart before plain likelihood takes over (0: never)."""
    gradient_limit: float = 1.0
    """Largest gradient norm of a step."""
    save_every: int = 500
    """Steps between checkpoints."""
    log_every: int = 20
    """Steps between lines in the metrics."""
    transitions: TransitionConfig = field(default_factory=TransitionConfig)
    """Which pairs of views are learned from."""

    def __post_init__(self):
        for name in (
            "components",
            "width",
            "trunk_layers",
            "head_layers",
            "steps",
            "batch_size",
            "save_every",
            "log_every",
        ):
            if getattr(self, name) < 1:
                raise UserError(f"mdn.{name} is {getattr(self, name)}; give at least 1")
        if not 0 < self.final_lr <= self.lr:
            raise UserError(f"mdn.lr is {self.lr} and mdn.final_lr {self.final_lr}; give lr >= final_lr > 0")
        if not 0 <= self.split_share < 1:
            raise UserError(f"mdn.split_share is {self.split_share}; give a number from 0 up to, but not including, 1")
        if not self.gradient_limit > 0:
            raise UserError(f"mdn.gradient_limit is {self.gradient_limit}; give a positive number")


def build_mdn(config: MdnConfig, latent_size: int) -> MDN:
    """Builds the untrained forecast network."""
    return MDN(latent_size, config.components, config.width, config.trunk_layers, config.head_layers)


@without_autocast
def train_mdn(
    config: MdnConfig, mdn: MDN, sampler: TransitionSampler, folder: Path, record: dict, overwrite: bool = False
) -> None:
    """Trains in a run folder and saves the model there; `record` is what the folder keeps as its config.

    Batches and schedules depend on seed and step alone: a resumed run takes the path of an uninterrupted one. The last
    line of the metrics tells whether the mixture uses its components.
    """
    everything = sampler.all_sources(torch.Generator().manual_seed(sampler.seed))
    mdn.set_statistics(everything.source, everything.target)
    annealing = Annealing.of(everything, round(config.split_share * config.steps), config.components)
    optimizer = torch.optim.Adam(mdn.parameters(), lr=config.lr, fused=True)
    guard = FiniteSteps()
    objects = {"mdn": mdn, "optimizer": optimizer}
    mdn.train()
    with TrainingRun(folder, record, config.steps, objects, {}, config.save_every, overwrite=overwrite) as run:
        for step in run.steps():
            batch = sampler.batch(step, config.batch_size)
            mixture = mdn(batch.source.mean, batch.source.logvar)
            nll = negative_log_likelihood(mixture, batch.samples)
            loss = annealing.loss(mixture, batch, step) if step < annealing.steps else nll
            optimizer.param_groups[0]["lr"] = cosine_rate(step, config.steps, config.lr, config.final_lr, WARM_UP)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            norm = clip_grad_norm_(mdn.parameters(), config.gradient_limit)
            if guard.accepts(step, {"loss": loss.detach(), "gradient": norm}):
                optimizer.step()
            if step % config.log_every == 0 or step + 1 == config.steps:
                largest = mixture.log_weights.exp().amax(dim=1).mean()
                run.log(step, nll=nll, largest_weight=largest, skipped=guard.skipped)
        mdn.eval()
        run.log(config.steps, **asdict(mixture_health(mdn, sampler)))
        save_model(folder, mdn, run)


@dataclass(frozen=True)
class Annealing:
    """Draws the components apart; distances are in units of the average posterior's standard deviation."""

    steps: int
    unit: Float[Tensor, " d"]
    first_temperature: float
    nudge: Float[Tensor, "k d"]
    """Where each component is pretended to be, off its mean, in units of the temperature's square root."""

    @classmethod
    def of(cls, pairs: TransitionBatch, steps: int, components: int) -> "Annealing":
        """Returns the annealing for these targets: it starts above the largest variance of their means."""
        unit = pairs.target.logvar.exp().mean(dim=0).sqrt()
        centred = (pairs.target.mean - pairs.target.mean.mean(dim=0)) / unit
        largest = float(torch.linalg.matrix_norm(centred.double(), ord=2)) ** 2 / len(centred)
        nudge = torch.randn(components, len(unit), generator=torch.Generator().manual_seed(0)).to(unit)
        nudge = NUDGE * torch.nn.functional.normalize(nudge - nudge.mean(dim=0), dim=1)
        return cls(steps, unit, FIRST_TEMPERATURE * max(largest, 1.0), nudge)

    def temperature(self, step: int) -> float:
        """Returns the temperature of a step: a geometric fall to 1, the variance of a posterior."""
        return self.first_temperature ** (1 - step / self.steps)

    def loss(self, mixture: GaussianMixture, batch: TransitionBatch, step: int) -> Float[Tensor, ""]:
        """Returns the negative log-likelihood with each target shared among the components by distance alone."""
        length = self.unit * self.temperature(step) ** 0.5
        places = mixture.means.detach() / length + self.nudge
        distance = (batch.target.mean[:, None] / length - places).square().sum(dim=-1)
        share = torch.softmax(-0.5 * distance, dim=-1)
        log_prob = mixture.log_weights[:, None] + mixture.component_log_prob(batch.samples)
        return -(share[:, None] * log_prob).sum(dim=-1).mean()


@dataclass(frozen=True)
class MixtureHealth:
    """Whether the mixture uses its components."""

    nll: float
    """Negative log-likelihood of the targets, nats."""
    single_nll: float
    """The same for one Gaussian with the mixture's mean and variance; close to `nll` means one mode is enough."""
    effective_components: float
    """exp(entropy of the weights), mean over sources."""
    used_components: float
    """exp(entropy of the mean weights): components that are used somewhere."""
    largest_weight: float
    """Largest weight of a mixture, mean over sources."""
    several_modes: float
    """Share of sources whose two heaviest components each weigh over 0.1 and lie over 3 standard deviations apart."""


@torch.no_grad()
def mixture_health(mdn: MDN, sampler: TransitionSampler, seed: int = 0) -> MixtureHealth:
    """Measures the forecast on every source view the sampler knows, one target each."""
    pairs = sampler.all_sources(torch.Generator().manual_seed(seed))
    mixture = mdn(pairs.source.mean, pairs.source.logvar)
    weights = mixture.log_weights.exp()
    single = GaussianMixture(
        torch.zeros(len(weights), 1), mixture.mean()[:, None], 0.5 * mixture.variance().log()[:, None]
    )
    return MixtureHealth(
        nll=float(negative_log_likelihood(mixture, pairs.samples)),
        single_nll=float(negative_log_likelihood(single, pairs.samples)),
        effective_components=float(_entropy(weights).exp().mean()),
        used_components=float(_entropy(weights.mean(dim=0, keepdim=True)).exp()),
        largest_weight=float(weights.amax(dim=1).mean()),
        several_modes=float(_has_several_modes(mixture).float().mean()),
    )


def _entropy(weights: Float[Tensor, "b k"]) -> Float[Tensor, " b"]:
    return -torch.xlogy(weights, weights).sum(dim=1)


def _has_several_modes(mixture: GaussianMixture) -> Bool[Tensor, " b"]:
    if mixture.log_weights.shape[1] == 1:
        return torch.zeros(len(mixture), dtype=torch.bool)
    heaviest = mixture.log_weights.topk(2, dim=1)
    index = heaviest.indices[:, :, None].expand(-1, -1, mixture.means.shape[2])
    means, variances = mixture.means.gather(1, index), (2 * mixture.log_sigmas.gather(1, index)).exp()
    distance = ((means[:, 0] - means[:, 1]).square() / variances.mean(dim=1)).sum(dim=1).sqrt()
    return (heaviest.values[:, 1].exp() > 0.1) & (distance > 3)
