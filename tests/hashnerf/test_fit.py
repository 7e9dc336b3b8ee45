"""The fit: learns a switchable scene, survives bad steps, resumes exactly, and averages over processes."""

import dataclasses
import math
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from hashnerf.errors import UserError
from hashnerf.field import Field, FieldConfig
from hashnerf.fit import FieldFit, FitConfig, RayBatch, fit_field, render_batch
from hashnerf.marching import MarchSettings
from hashnerf.occupancy import OccupancyConfig, OccupancyGrid
from hashnerf.training_run import TrainingRun
from tests.hashnerf.analytic_scene import BOX, Pictures, ring_of_cameras

FIELD = FieldConfig(levels=5, log2_table_size=13, base_resolution=6, finest_resolution=64, hidden_width=32)
MARCH = MarchSettings(candidates=64, even_distance=5.0)
CONFIG = FitConfig(rays=256, batch_samples=4096, log_every=1, occupancy_every=4)
BANK = torch.tensor([[-1.0], [1.0]])


def build(config=CONFIG, steps=100) -> FieldFit:
    torch.manual_seed(0)
    grid = OccupancyGrid(OccupancyConfig(cell=0.3), BOX)
    return FieldFit(Field(FIELD, BOX, 1), grid, config, MARCH, steps)


@pytest.fixture(scope="module")
def pictures() -> Pictures:
    return Pictures(ring_of_cameras(12, 32))


def weights(fit):
    return [parameter.detach().clone() for parameter in fit.field.parameters()]


def test_a_condition_switches_the_ball():
    pictures, unseen = Pictures(ring_of_cameras(30, 32)), Pictures(ring_of_cameras(5, 32, turn=0.05))
    config = FitConfig(rays=512, batch_samples=8192, network_learning_rate=0.01)
    fit = build(config, steps=150)
    for step in range(150):
        if step % config.occupancy_every == 0:
            fit.update_occupancy(BANK)
        generator = fit.generator(step)
        fit.step(step, pictures.draw(step, fit.rays_wanted(), generator), generator)
    with fit.average.applied(), torch.no_grad():
        truth = unseen.batch(torch.arange(len(unseen.rays)))
        wrong = dataclasses.replace(truth, condition_index=1 - truth.condition_index)
        error, switched = (
            (render_batch(fit.field, batch, fit.occupancy, MARCH).rgb - truth.rgb).square().mean().item()
            for batch in (truth, wrong)
        )
    assert -10 * math.log10(error) > 16
    assert switched > 2 * error


def test_n133_a_bad_step_changes_nothing(pictures, numeric_row):
    fit, changed = build(), 0
    for step in range(12):
        batch = pictures.draw(step, 64, fit.generator(step))
        if step in (5, 6):
            bad = math.nan if step == 5 else math.inf
            batch = dataclasses.replace(batch, rgb=torch.where(torch.arange(64)[:, None] == 3, bad, batch.rgb))
        before = weights(fit), [a.clone() for a in fit.average.averages]
        moments = [value.clone() for value in _tensors(fit.state_dict()["optimizer"])]
        metrics = fit.step(step, batch, fit.generator(step))
        after = weights(fit), fit.average.averages
        same = all(torch.equal(a, b) for old, new in zip(before, after) for a, b in zip(old, new))
        assert same == (step in (5, 6))
        if step in (5, 6):
            assert all(torch.equal(a, b) for a, b in zip(moments, _tensors(fit.state_dict()["optimizer"])))
        changed += step in (5, 6) and not same
    numeric_row("N133", "NaN at step 5, inf at 6: steps that changed weights, moments or average", changed)
    assert metrics["skipped"] == 2


def _tensors(state):
    return [value for row in state["state"].values() for value in row.values()]


def test_n133_eleven_bad_steps_in_a_row_name_the_term(pictures, numeric_row):
    fit = build()
    batch = pictures.draw(0, 32, fit.generator(0))
    bad = dataclasses.replace(batch, rgb=batch.rgb * math.nan)
    for step in range(10):
        fit.step(step, bad, fit.generator(step))
    with pytest.raises(UserError, match="colour loss") as refused:
        fit.step(10, bad, fit.generator(10))
    numeric_row("N133", "eleven bad batches in a row: went on", refused is None)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_n130_n131_half_precision_weights_are_refused(numeric_row, dtype):
    field = Field(FIELD, BOX, 1).to(dtype)
    with pytest.raises(ValueError, match="half precision") as refused:
        FieldFit(field, OccupancyGrid(OccupancyConfig(), BOX), CONFIG, MARCH, 10)
    numeric_row("N130" if dtype == torch.float16 else "N131", f"weights in {dtype}: taken in", refused is None)


def test_n130_n132_gradients_of_any_size_and_entries_without_one(numeric_row):
    fit = build()
    table = fit.field.hash_grid.table
    before = table.detach().clone()
    sizes = torch.tensor([0.0, 1e-6, 1e-4, 1.0, -1.0, 1e-12, 1e-20, 1e-30, 1e15, 1e-45])
    table.grad = torch.zeros_like(table)
    for _ in range(1000):
        table.grad.view(-1)[: len(sizes)] = sizes
        fit.optimizer.step()
    bad = sum(int((~one.isfinite()).sum()) for one in [table, *_tensors(fit.state_dict()["optimizer"])])
    numeric_row("N130", "gradients from 0 to 1e15, 1000 steps: weights or moments not finite", bad)
    moved = (table != before).view(-1)
    numeric_row("N132", f"{table.numel()} entries, 9 touched, 1000 steps: others that moved", int(moved[10:].sum()))
    assert not moved[0] and moved[1:7].all()


def test_n132_table_entries_that_no_ray_touches_stay_as_they_are(pictures, numeric_row):
    fit = build()
    before = fit.field.hash_grid.table.detach().clone()
    batch = pictures.batch(torch.zeros(16, dtype=torch.int64))  # one ray, again and again
    touched = torch.zeros_like(before, dtype=torch.bool)
    for step in range(60):
        fit.step(step, batch, fit.generator(step))
        touched |= fit.field.hash_grid.table.grad != 0
    assert 0 < touched.float().mean() < 0.5
    strayed = (fit.field.hash_grid.table != before)[~touched].sum()
    numeric_row("N132", "one ray, 60 steps: entries moved that it never touched", int(strayed))
    assert (fit.field.hash_grid.table[touched] != before[touched]).all()


def test_the_learning_rate_depends_on_the_step_alone(pictures):
    fit = build(dataclasses.replace(CONFIG, learning_rate=0.1, network_learning_rate=0.2, final_share=0.01), steps=100)
    for step, expected in ((0, 0.1), (50, 0.01), (100, 0.001), (400, 0.001)):
        fit.step(step, pictures.draw(step, 8, fit.generator(step)), None)
        quick, networks = (group["lr"] for group in fit.optimizer.param_groups)
        assert quick == pytest.approx(expected)
        assert networks == pytest.approx(2 * expected)


def test_samples_a_ray_grow_with_the_step(pictures):
    fit = build(dataclasses.replace(CONFIG, first_samples_per_opacity=0.5), steps=100)
    for _ in range(8):
        fit.update_occupancy(BANK)
    batch = pictures.draw(0, 256, fit.generator(0))
    counts = [fit.step(step, batch, fit.generator(0))["samples"] for step in (0, 50, 100, 400)]
    assert counts[0] * 1.5 < counts[1]
    assert counts[1] * 1.2 < counts[2]
    assert counts[3] == pytest.approx(counts[2], rel=0.05)


def test_rays_adapt_to_the_samples_wanted(pictures):
    fit = build()
    assert fit.rays_wanted() == 256
    for step in range(20):
        metrics = fit.step(step, pictures.draw(step, fit.rays_wanted(), fit.generator(step)), fit.generator(step))
    assert metrics["samples"] == pytest.approx(4096, rel=0.25)


def test_a_weight_of_zero_takes_a_ray_out(pictures):
    rows = torch.randint(len(pictures.rays), (40,))
    half = pictures.batch(rows)
    weight = (torch.arange(40) < 20).float() * 2  # twenty rays of forty, counted twice: the mean over twenty
    fits = build(), build()
    fits[0].step(0, dataclasses.replace(half, weight=weight), None)
    fits[1].step(0, pictures.batch(rows[:20]), None)
    for a, b in zip(fits[0].field.parameters(), fits[1].field.parameters()):
        assert torch.allclose(a.grad, b.grad, rtol=1e-4, atol=1e-7)


def test_a_batch_that_misses_the_box_still_steps():
    fit = build()
    rays = Pictures(ring_of_cameras(2, 4)).rays
    away = dataclasses.replace(rays, origins=rays.origins + 100.0)
    fit.step(0, RayBatch(away, torch.rand(len(away), 3), BANK, torch.zeros(len(away), dtype=torch.int64)), None)
    assert fit.finite.skipped == 0
    assert all(parameter.grad is not None for parameter in fit.field.parameters())


@pytest.mark.parametrize("loss", ["mse", "huber"])
def test_both_losses_lead_the_same_way(pictures, loss):
    fit = build(dataclasses.replace(CONFIG, loss=loss))
    batch = pictures.batch(torch.arange(0, len(pictures.rays), 97))
    losses = [fit.step(step, batch, None)["loss"] for step in range(30)]
    assert losses[-1] < 0.5 * losses[0]


def run_to(folder: Path, pictures: Pictures, stop: int | None) -> FieldFit:
    """Train 12 steps in a run folder; stop hard after `stop` steps if given."""
    fit = build(steps=12)
    draws = []

    def draw(step, count, generator):
        if step == stop:
            raise KeyboardInterrupt
        draws.append(step)
        return pictures.draw(step, count, generator)

    with TrainingRun(folder, {"name": "test"}, 12, fit.objects, save_every=4) as run:
        try:
            fit_field(fit, draw, lambda step: BANK, run)
        except KeyboardInterrupt:
            assert stop is not None
    fit.steps_done = draws
    return fit


def test_k06_resuming_is_bit_exact(tmp_path, pictures, numeric_row):
    straight = run_to(tmp_path / "straight", pictures, None)
    run_to(tmp_path / "broken", pictures, 6)
    resumed = run_to(tmp_path / "broken", pictures, None)
    assert resumed.steps_done == list(range(4, 12))
    parts = [
        [
            *weights(fit),
            *fit.average.averages,
            *fit.occupancy.state_dict().values(),
            *_tensors(fit.optimizer.state_dict()),
        ]
        for fit in (straight, resumed)
    ]
    different = sum(not torch.equal(a, b) for a, b in zip(*parts, strict=True))
    inputs = f"field, average, occupancy grid, moments ({len(parts[0])} tensors) of 12 steps, resumed at 4: that differ"
    numeric_row("K06", inputs, different)
    lines = [(tmp_path / name / "metrics.jsonl").read_text().splitlines() for name in ("straight", "broken")]
    assert len(lines[0]) == len(lines[1]) == 12


WORKER = """
import sys
import torch
from lightning_fabric import Fabric
from safetensors.torch import save_file
from tests.hashnerf.test_fit import joined_batch, gradients_of
torch.set_num_threads(1)
fabric = Fabric(accelerator="cpu", devices=2, strategy="ddp")
fabric.launch()
halves = joined_batch()[fabric.global_rank :: 2]
gradients, metrics = gradients_of(halves, fabric)
rows = {f"{i:03d}": gradient for i, gradient in enumerate(gradients)} | {"loss": torch.tensor(metrics["loss"])}
save_file(rows, sys.argv[1] + str(fabric.global_rank))
fabric.barrier()
torch.distributed.destroy_process_group()  # else its threads may outlive the interpreter, which then aborts
"""


def joined_batch() -> torch.Tensor:
    return torch.arange(0, 2048, 16)


def gradients_of(rows, fabric=None):
    torch.manual_seed(0)
    grid = OccupancyGrid(OccupancyConfig(cell=0.3), BOX)
    fit = FieldFit(Field(FIELD, BOX, 1), grid, CONFIG, MARCH, 10, fabric)
    metrics = fit.step(0, Pictures(ring_of_cameras(2, 32)).batch(rows), None)
    return [parameter.grad.clone() for parameter in fit.field.parameters()], metrics


def test_two_processes_equal_one_on_the_joined_batch(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    root = Path(__file__).parents[2]
    common = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": "2", "PYTHONPATH": str(root)}
    workers = []
    for rank in range(2):
        place = {"RANK": str(rank), "LOCAL_RANK": str(rank), "GROUP_RANK": "0", "LOCAL_WORLD_SIZE": "2"}
        place["TORCHELASTIC_RUN_ID"] = "test"
        command = [sys.executable, "-c", WORKER, str(tmp_path / "rank")]
        workers.append(subprocess.Popen(command, env={**os.environ, **common, **place}, cwd=root))
    assert [worker.wait(timeout=120) for worker in workers] == [0, 0]
    alone, metrics = gradients_of(joined_batch())
    for rank in range(2):
        result = load_file(tmp_path / f"rank{rank}")
        assert float(result.pop("loss")) == pytest.approx(metrics["loss"], rel=1e-5)
        for a, b in zip((result[name] for name in sorted(result)), alone):
            assert torch.allclose(a, b, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("learning_rate", 0.0),
        ("final_share", math.nan),
        ("rays", 0),
        ("first_samples_per_opacity", 1e300),
        ("batch_samples", 0),
        ("log_every", 0),
    ],
)
def test_impossible_configs_name_the_key(key, value):
    with pytest.raises(UserError, match=f"fit.{key} is"):
        FitConfig(**{key: value})


def test_guided_rays_ask_for_the_density_under_their_own_condition(pictures):
    fit = build()
    with torch.no_grad():
        fit.field.hash_grid.table.uniform_(-2, 2)  # no two places alike
        fit.field.density_network.weights[0][:, -1] *= 5  # nor two conditions
    guided = dataclasses.replace(MARCH, guided_per_opacity=4.0)
    batch = pictures.batch(torch.arange(0, len(pictures.rays), len(pictures.rays) // 40))
    assert set(batch.condition_index.tolist()) == {0, 1}
    with torch.no_grad():
        together = render_batch(fit.field, batch, fit.occupancy, guided)
        for row in range(len(batch.conditions)):
            own = (batch.condition_index == row).nonzero()[:, 0]
            alone = render_batch(
                fit.field,
                RayBatch(batch.rays.select(own), batch.rgb[own], batch.conditions[row][None], torch.zeros_like(own)),
                fit.occupancy,
                guided,
            )
            assert torch.allclose(together.rgb[own], alone.rgb, atol=1e-5)
            assert torch.allclose(together.opacity[own], alone.opacity, atol=1e-5)
