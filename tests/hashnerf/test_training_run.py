"""A training run: resume bit for bit, refuse another config, keep the metrics consistent, stop when asked."""

import contextlib
import json
import os
import signal
import threading
import time

import numpy as np
import pytest
import torch

from hashnerf.checkpoints import checkpoint_steps, load_checkpoint
from hashnerf.errors import DataError, UserError
from hashnerf.training_run import TrainingRun


class Average:
    """An exponential average with its own state, as a run meets it."""

    def __init__(self, model: torch.nn.Module):
        self.model = model
        self.values = [parameter.detach().clone() for parameter in model.parameters()]
        self.updates = 0

    def update(self) -> None:
        self.updates += 1
        for value, parameter in zip(self.values, self.model.parameters()):
            value.lerp_(parameter.detach(), 0.1)

    def state_dict(self) -> dict:
        return {"values": self.values, "updates": self.updates}

    def load_state_dict(self, state: dict) -> None:
        self.values, self.updates = list(state["values"]), state["updates"]


class Toy:
    """All that a training loop carries along: weights, statistics, dropout, moments, schedule, average, generators."""

    def __init__(self, size: int = 4):
        nn = torch.nn
        with torch.random.fork_rng():
            torch.manual_seed(1)
            self.model = nn.Sequential(nn.Linear(4, size), nn.BatchNorm1d(size), nn.Dropout(0.2), nn.Linear(size, 1))
        self.optimizer = torch.optim.Adam(self.model.parameters(), lr=0.02)
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimizer, 40)
        self.average = Average(self.model)
        self.generator = torch.Generator().manual_seed(2)
        self.losses: list[float] = []

    def run(self, folder, config=None, total=40, **options) -> TrainingRun:
        objects = {name: getattr(self, name) for name in ("model", "optimizer", "schedule", "average")}
        options = {"save_every": 7, **options}
        return TrainingRun(folder, config or {"rate": 0.02}, total, objects, {"data": self.generator}, **options)

    def train(self, folder, until: int | None = None, **options) -> "Toy":
        with self.run(folder, **options) as run:
            for step in run.steps():
                if step == until:
                    break  # as if the machine had been switched off here
                x = torch.randn(8, 4, generator=self.generator) + torch.rand(8, 1) + float(np.random.rand())
                loss = (self.model(x) - x.sum(1, keepdim=True)).square().mean()
                self.optimizer.zero_grad()
                loss.backward()
                self.optimizer.step()
                self.schedule.step()
                self.average.update()
                self.losses.append(loss.item())
                run.log(step, loss=loss, rate=self.schedule.get_last_lr()[0])
        return self


def start_random_numbers() -> None:
    torch.manual_seed(3)
    np.random.seed(3)


def metrics(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def finish(folder, total: int = 40) -> list[float]:
    toy = Toy()
    start_random_numbers()
    return toy.train(folder, total=total).losses


def differences(a, b) -> list[str]:
    """What is not the same bit for bit in two runs' last checkpoints: weights, moments, averages, generators, ..."""
    first, second = load_checkpoint(a / "checkpoints"), load_checkpoint(b / "checkpoints")
    assert first.step == second.step
    assert set(first.tensors) == set(second.tensors)
    # Python's own stream is left out: the type checker that is live in tests draws from it.
    names = [name for name in first.tensors if not name.startswith("random.python")]
    different = [name for name in names if not torch.equal(first.tensors[name], second.tensors[name])]
    return different + ["objects"] * (first.state["objects"] != second.state["objects"])


@pytest.mark.parametrize("stops", [(20,), (7,), (8, 22, 39), (1,)])
def test_k06_resuming_is_bit_exact(tmp_path, stops, numeric_row):
    whole = finish(tmp_path / "whole")
    start_random_numbers()
    for stop in stops:
        Toy().train(tmp_path / "parts", until=stop)
        torch.manual_seed(77)  # whatever happens in between, the checkpoint's generators win
        if stop < 7:
            start_random_numbers()  # nothing was saved: the next start is a fresh one
    last = Toy().train(tmp_path / "parts")
    assert last.losses == whole[-len(last.losses) :]
    assert [line["step"] for line in metrics(tmp_path / "parts")] == list(range(40))
    changed = sum(line["loss"] != loss for line, loss in zip(metrics(tmp_path / "parts"), whole))
    changed += len(differences(tmp_path / "whole", tmp_path / "parts"))
    numeric_row("K06", f"40 steps, stopped at {stops} and resumed: losses and tensors that differ", changed)


@pytest.mark.parametrize("forgotten", ["optimizer", "schedule", "average", "data"])
def test_k06_the_comparison_would_notice_a_forgotten_part(tmp_path, monkeypatch, forgotten, numeric_row):
    finish(tmp_path / "whole")
    start_random_numbers()
    Toy().train(tmp_path / "parts", until=20)
    toy = Toy()
    if forgotten == "data":
        monkeypatch.setattr("hashnerf.training_run.restore_random_state", lambda state, generators: None)
    else:
        monkeypatch.setattr(type(getattr(toy, forgotten)), "load_state_dict", lambda self, state: None)
    toy.train(tmp_path / "parts")
    unnoticed = not differences(tmp_path / "whole", tmp_path / "parts")
    numeric_row("K06", f"{forgotten} not restored: not noticed by this comparison", unnoticed)


def test_a_finished_run_does_nothing(tmp_path, capsys):
    finish(tmp_path)
    before = (tmp_path / "metrics.jsonl").read_bytes()
    toy = Toy().train(tmp_path)
    assert toy.losses == []
    assert "already finished (40 steps); nothing to do." in capsys.readouterr().err
    assert (tmp_path / "metrics.jsonl").read_bytes() == before
    assert toy.average.updates == 40  # the trained state is there for what comes after training


def test_files_and_bookkeeping(tmp_path):
    Toy().train(tmp_path / "a" / "b", total=20)
    folder = tmp_path / "a" / "b"
    assert {path.name for path in folder.iterdir()} == {".lock", "config.yaml", "metrics.jsonl", "checkpoints"}
    assert (folder / "config.yaml").read_text() == "rate: 0.02\n"
    assert checkpoint_steps(folder / "checkpoints") == [14, 20]
    state = load_checkpoint(folder / "checkpoints").state
    assert state["torch"] == torch.__version__
    assert 0 < state["seconds"] < 600
    assert 50 < state["peak_memory_mb"] < 100_000
    seconds = [line["seconds"] for line in metrics(folder)]
    assert seconds == sorted(seconds)


def test_seconds_and_memory_add_up_over_processes(tmp_path):
    Toy().train(tmp_path, until=8)
    earlier = load_checkpoint(tmp_path / "checkpoints").state
    with Toy().run(tmp_path) as run:
        assert run.seconds >= earlier["seconds"]
        assert run.peak_memory_mb >= earlier["peak_memory_mb"]


def test_k07_another_config_is_refused_with_a_difference(tmp_path, numeric_row):
    config = {"rate": 0.02, "net": {"width": 4, "old": 1}}
    Toy().train(tmp_path, config=config, until=8)
    with (
        pytest.raises(
            UserError, match=r"net.width: 4 -> 8; net.old: 1 -> \(absent\); new: \(absent\) -> True"
        ) as caught,
        Toy().run(tmp_path, config={"rate": 0.02, "net": {"width": 8}, "new": True}),
    ):
        pass
    assert "choose another run name, or start over with --overwrite true" in str(caught.value)
    accepted = []
    for key, value in (("rate", 0.03), ("components", 4), ("steps", 80), ("dtype", "bfloat16"), ("processes", 2)):
        with contextlib.suppress(UserError), Toy().run(tmp_path, config={**config, key: value}):
            accepted.append(key)
    assert checkpoint_steps(tmp_path / "checkpoints") == [7]
    Toy().train(tmp_path, config=config)  # the refusals have released the lock and harmed nothing
    numeric_row(
        "K07", "another rate, K, number of steps, dtype, number of processes: resumed all the same", len(accepted)
    )


def test_k07_another_torch_is_told(tmp_path, monkeypatch, capsys, numeric_row):
    """Not refused: weights stay good through an update, but nobody should expect the same bits."""
    with monkeypatch.context() as patch:
        patch.setattr(torch, "__version__", "2.0.0")
        Toy().train(tmp_path, until=8)
    Toy().train(tmp_path)
    said = f"saved by torch 2.0.0, going on with {torch.__version__}, so not bit for bit" in capsys.readouterr().err
    numeric_row("K07", "saved by another torch: resumed without a word", not said)


def test_overwrite_starts_over(tmp_path):
    finish(tmp_path)
    toy = Toy()
    start_random_numbers()
    toy.train(tmp_path, config={"rate": 0.5}, total=10, overwrite=True)
    assert len(toy.losses) == 10
    assert len(metrics(tmp_path)) == 10
    assert (tmp_path / "config.yaml").read_text() == "rate: 0.5\n"
    assert checkpoint_steps(tmp_path / "checkpoints") == [7, 10]


def test_a_config_without_a_checkpoint_may_change(tmp_path):
    Toy().train(tmp_path, until=2)
    Toy().train(tmp_path, config={"rate": 0.5}, until=2)
    assert (tmp_path / "config.yaml").read_text() == "rate: 0.5\n"


def test_a_damaged_newest_checkpoint_costs_only_its_own_steps(tmp_path, caplog):
    whole = finish(tmp_path / "whole")
    finish(tmp_path / "hurt")
    path = tmp_path / "hurt" / "checkpoints" / "0000040" / "tensors.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    again = Toy().train(tmp_path / "hurt")
    assert "falling back to step 35" in caplog.text
    assert again.losses == whole[35:]
    assert not differences(tmp_path / "whole", tmp_path / "hurt")
    assert len(metrics(tmp_path / "hurt")) == 40


def test_all_checkpoints_damaged_is_an_error_not_a_fresh_start(tmp_path):
    finish(tmp_path)
    for step in (35, 40):
        (tmp_path / "checkpoints" / f"{step:07d}" / "state.json").unlink()
    with pytest.raises(UserError, match="no good checkpoint is left"):
        Toy().train(tmp_path)


def test_a_checkpoint_of_another_model_is_refused(tmp_path):
    finish(tmp_path)
    with pytest.raises(DataError, match="needs"):
        Toy(size=5).train(tmp_path)
    toy = Toy()
    with (
        pytest.raises(UserError, match=r"holds the state of \['average', 'optimizer', 'schedule'\].*\['optimizer'\]"),
        TrainingRun(tmp_path, {"rate": 0.02}, 40, {"model": toy.model, "optimizer": toy.optimizer}),
    ):
        pass


def test_processor_seconds_do_not_count_waiting(tmp_path):
    with Toy().run(tmp_path) as run:
        time.sleep(0.3)
        run.log(0, loss=1.0)
    line = metrics(tmp_path)[0]
    assert line["seconds"] >= 0.3 > line["processor_seconds"]


def test_metrics_with_values_that_are_not_finite(tmp_path):
    with Toy().run(tmp_path) as run:
        run.log(0, loss=torch.tensor(float("nan")), norm=float("inf"), ok=1, name="x", flag=True, none=None)
    line = metrics(tmp_path)[0]
    assert line.pop("seconds") >= 0 and line.pop("processor_seconds") >= 0
    assert line == {
        **{"step": 0, "loss": None, "norm": None, "ok": 1, "name": "x", "flag": True, "none": None},
        "non_finite": ["loss", "norm"],
    }
    assert "NaN" not in (tmp_path / "metrics.jsonl").read_text()


def test_a_torn_last_line_of_the_metrics_is_dropped(tmp_path):
    Toy().train(tmp_path, until=10)
    with open(tmp_path / "metrics.jsonl", "a") as file:
        file.write('{"step": 5, "lo')
    Toy().train(tmp_path)
    assert [line["step"] for line in metrics(tmp_path)] == list(range(40))


def test_weights_that_are_not_finite_do_not_replace_a_good_checkpoint(tmp_path):
    toy = Toy()
    with pytest.raises(UserError) as caught, toy.run(tmp_path) as run:
        for step in run.steps():
            if step == 10:
                toy.model[0].weight.data[0, 0] = torch.nan
                toy.model[3].bias.data[0] = torch.inf
                toy.average.values[0][0, 0] = torch.nan
    for words in ("model.0.weight, model.3.bias, average.values.0 not finite", "by step 14", "step 7 is intact"):
        assert words in str(caught.value)
    assert checkpoint_steps(tmp_path / "checkpoints") == [7]


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_k08_a_signal_finishes_the_step_and_saves(tmp_path, capfd, number, status, numeric_row):
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as caught, Toy().run(tmp_path) as run:
        for step in run.steps():
            if step == 3:
                signal.raise_signal(number)
                reached = True
    assert reached
    assert caught.value.code == status
    lost = 4 - checkpoint_steps(tmp_path / "checkpoints")[-1]
    numeric_row("K08", f"{number.name} in step 4, exit {status}: finished steps that are lost", lost)
    error = capfd.readouterr().err
    assert f"stopped by {number.name} and saved after step 4; run the same command to continue." in error
    assert signal.getsignal(number) is before


def test_signals_are_left_alone_outside_the_loop_and_other_threads(tmp_path):
    before = signal.getsignal(signal.SIGINT)
    with Toy().run(tmp_path) as run:
        assert signal.getsignal(signal.SIGINT) is before
        for step in run.steps():
            if step == 1:
                assert signal.getsignal(signal.SIGINT) is not before
                break
    assert signal.getsignal(signal.SIGINT) is before
    thread = threading.Thread(target=Toy().train, args=(tmp_path,))
    thread.start()
    thread.join()
    assert checkpoint_steps(tmp_path / "checkpoints") == [35, 40]


def test_an_error_in_the_loop_saves_nothing_and_frees_the_run(tmp_path):
    with pytest.raises(ZeroDivisionError), Toy().run(tmp_path) as run:
        for step in run.steps():
            _ = 1 / (9 - step)
    assert checkpoint_steps(tmp_path / "checkpoints") == [7]
    Toy().train(tmp_path)


def test_k09_two_trainings_in_one_folder_are_refused(tmp_path, numeric_row):
    both = []
    with (
        Toy().run(tmp_path) as first,
        pytest.raises(UserError, match="in use by process"),
        Toy().run(tmp_path) as second,
    ):
        both = [first, second]
    numeric_row("K09", "a second training in a run's folder: let in", len(both))


def test_a_process_that_does_not_write_follows_silently(tmp_path, capsys):
    Toy().train(tmp_path, until=20)
    capsys.readouterr()
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    with Toy().run(tmp_path):  # while another process holds the lock
        follower = Toy().train(tmp_path, writes=False)
        new = {path for path in tmp_path.rglob("*") if before.get(path) != path.stat().st_mtime_ns}
    assert len(follower.losses) == 40 - 14
    assert new <= {tmp_path / ".lock"}
    assert capsys.readouterr().err == ""


def test_k02_a_full_disk_while_logging(tmp_path, numeric_row):
    with Toy().run(tmp_path) as run:
        os.symlink("/dev/full", tmp_path / "metrics.jsonl")
        run._trimmed = True  # reading /dev/full would never end
        with pytest.raises(
            UserError, match=r"metrics.jsonl: cannot be written \(No space left on device\); No checkpoint"
        ):
            run.log(0, loss=1.0)
    (tmp_path / "metrics.jsonl").unlink()
    finished = len(Toy().train(tmp_path).losses)
    numeric_row("K02", "metrics.jsonl on a full disk: steps that the next start lacks", 40 - finished)


def test_k02_a_full_disk_while_saving(tmp_path, monkeypatch, numeric_row):
    toy = Toy()
    with (
        pytest.raises(
            UserError, match=r"No space left.*The checkpoint of step 7 is intact: run the same command again"
        ),
        toy.run(tmp_path) as run,
    ):
        for step in run.steps():
            if step == 8:
                monkeypatch.setattr(os, "fsync", lambda descriptor: (_ for _ in ()).throw(OSError(28, "No space left")))
    monkeypatch.undo()
    numeric_row("K02", "ENOSPC in a save: good checkpoints lost", 7 not in checkpoint_steps(tmp_path / "checkpoints"))
    Toy().train(tmp_path)


def test_k03_unusable_folders_and_numbers(tmp_path, numeric_row):
    (tmp_path / "file").write_text("")
    started = []
    with pytest.raises(UserError, match="cannot be used as a run folder"), Toy().run(tmp_path / "file") as run:
        started.append(run)
    numeric_row("K03", "a file in the run folder's place: started all the same", len(started))
    for options in ({"total": 0}, {"save_every": 0}):
        with pytest.raises(UserError, match="at least 1"):
            Toy().run(tmp_path, **options)
