"""A training run on disk: resume, checkpoints, metrics, lock, signals and progress around one readable loop.

    with TrainingRun(folder, config, total_steps, {"model": model, "optimizer": optimizer}) as run:
        for step in run.steps():
            ...
            run.log(step, loss=loss)

`step` counts from 0. A checkpoint of step n holds the state after n finished steps (0 .. n-1). The folder holds
`config.yaml`, `metrics.jsonl` (one JSON object a line) and `checkpoints/`. Starting the same command again continues
after the newest good checkpoint, bit-exactly on a CPU; a finished run does nothing; another config is refused.
"""

import json
import math
import os
import re
import resource
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from hashnerf.checkpoints import (
    checkpoint_steps,
    load_checkpoint,
    load_module_state,
    module_tensors,
    pack,
    save_checkpoint,
    sweep_leftovers,
    unpack,
)
from hashnerf.command_line import config_changes, plain_config, read_yaml, save_config
from hashnerf.errors import UserError
from hashnerf.progress import StepProgress, say
from hashnerf.random_state import capture_random_state, restore_random_state
from hashnerf.run_lock import RunLock

RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
WINDOWS_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}
CONFIG, METRICS, CHECKPOINTS = "config.yaml", "metrics.jsonl", "checkpoints"


@runtime_checkable
class Stateful(Protocol):
    """Anything a run can save: modules, optimisers, schedulers, averages, counters."""

    def state_dict(self) -> dict[str, Any]: ...

    def load_state_dict(self, state: dict[str, Any]) -> Any: ...


class TrainingRun:
    """Own one run folder while training; see the module's example.

    Of several processes that train together, only one may have `writes`: the others continue from the same checkpoint
    and count the same steps, but touch no file.
    """

    def __init__(
        self,
        folder: Path,
        config: Any,
        total_steps: int,
        objects: dict[str, Stateful],
        generators: dict[str, torch.Generator] | None = None,
        save_every: int = 500,
        keep: int = 2,
        overwrite: bool = False,
        writes: bool = True,
    ):
        if total_steps < 1 or save_every < 1:
            raise UserError(f"total_steps = {total_steps} and save_every = {save_every} must both be at least 1.")
        self.folder, self.config, self.total_steps = folder, config, total_steps
        self.objects, self.generators = objects, generators or {}
        self.save_every, self.keep, self.overwrite, self.writes = save_every, keep, overwrite, writes
        self.completed = 0
        self._earlier_seconds, self._earlier_peak = 0.0, 0.0
        self._saved, self._trimmed, self._resumed_step = -1, False, 0
        self._signal: int | None = None
        self._handlers: dict[int, Any] = {}
        self._progress: StepProgress | None = None
        self._lock = RunLock(folder)

    def __enter__(self) -> "TrainingRun":
        try:
            if self.writes:
                self.folder.mkdir(parents=True, exist_ok=True)
                self._lock.acquire()
            self._prepare()
        except OSError as error:
            self._lock.release()
            raise UserError(f"{self.folder}: cannot be used as a run folder ({error.strerror}).") from error
        except BaseException:
            self._lock.release()
            raise
        self._entered, self._processor_before = time.monotonic(), time.process_time()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop_watching()
        self._lock.release()

    @property
    def finished(self) -> bool:
        """Whether every step has been done."""
        return self.completed >= self.total_steps

    @property
    def seconds(self) -> float:
        """Seconds spent in this run so far, all its processes together."""
        return self._earlier_seconds + time.monotonic() - self._entered

    @property
    def peak_memory_mb(self) -> float:
        """Largest resident memory of any process of this run, in megabytes."""
        unit = 1e6 if sys.platform == "darwin" else 1e3  # bytes on macOS, kilobytes elsewhere
        return max(self._earlier_peak, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit)

    def steps(self) -> Iterator[int]:
        """Yield the steps still to do; save when due, at the end, and when asked to stop (then exit 130 or 143)."""
        if self.finished:
            self._say(f"already finished ({self.completed} steps); nothing to do.")
            return
        if self.completed:
            self._say(f"continuing after step {self.completed} of {self.total_steps}.")
        self._start_watching()
        try:
            for step in range(self.completed, self.total_steps):
                yield step
                self.completed = step + 1
                if self._signal is not None or self.finished or self.completed % self.save_every == 0:
                    self.save()
                if self._progress is not None:
                    self._progress.show(self.completed)
                if self._signal is not None:
                    self._leave()
        finally:
            self._stop_watching()

    def log(self, step: int, **values: Any) -> None:
        """Append a line to metrics.jsonl; NaN and infinite values become null and are named in `non_finite`.

        Beside the values: `step`, `seconds` of all processes of the run, `processor_seconds` of this one.
        """
        if not self.writes:
            return
        line: dict[str, Any] = {"step": step, "seconds": round(self.seconds, 3)}
        # of this process alone: on a busy machine it tells more than the clock on the wall
        line["processor_seconds"] = round(time.process_time() - self._processor_before, 3)
        non_finite = []
        for name, value in values.items():
            number = value.item() if isinstance(value, Tensor) else value
            if isinstance(number, float) and not math.isfinite(number):
                non_finite.append(name)
                number = None
            line[name] = number
        if non_finite:
            line["non_finite"] = non_finite
        try:
            if not self._trimmed:
                self._trim_metrics()
            with open(self.folder / METRICS, "a", encoding="utf-8") as file:
                file.write(json.dumps(line, allow_nan=False) + "\n")
        except OSError as error:
            raise UserError(
                f"{self.folder / METRICS}: cannot be written ({error.strerror}); {self._how_to_go_on()}"
            ) from error
        if self._progress is not None:
            shown = ((name, line[name]) for name in values)
            self._progress.values = " ".join(f"{n} {v:.4g}" for n, v in shown if isinstance(v, int | float))

    def save(self) -> None:
        """Write a checkpoint of the present state now; UserError when weights are not finite or the disk refuses."""
        if self._saved == self.completed or not self.writes:
            return
        tensors: dict[str, Tensor] = {}
        states = {}
        for name, thing in self.objects.items():
            if isinstance(thing, nn.Module):
                tensors.update(module_tensors(thing, name))
            else:
                states[name] = pack(thing.state_dict(), name, tensors)
        self._refuse_non_finite(tensors)
        state = {
            "config": pack(plain_config(self.config), "config", tensors),
            "objects": states,
            "random": pack(capture_random_state(self.generators), "random", tensors),
            "torch": torch.__version__,
            "total_steps": self.total_steps,
            "seconds": round(self.seconds, 3),
            "peak_memory_mb": round(self.peak_memory_mb, 1),
        }
        try:
            save_checkpoint(self.folder / CHECKPOINTS, self.completed, tensors, state, self.keep)
        except UserError as error:
            raise UserError(f"{error} {self._how_to_go_on()}") from error
        self._saved = self.completed

    def _prepare(self) -> None:
        """Bring the folder and the objects to the point where training starts or continues."""
        checkpoints = self.folder / CHECKPOINTS
        if self.writes and self.overwrite:
            shutil.rmtree(checkpoints, ignore_errors=True)
            (self.folder / METRICS).unlink(missing_ok=True)
        if self.writes:
            sweep_leftovers(checkpoints)
        if checkpoint_steps(checkpoints) and not self.overwrite:
            self._resume(checkpoints)
        elif self.writes:
            save_config(self.config, self.folder / CONFIG)

    def _resume(self, checkpoints: Path) -> None:
        step, tensors, state = load_checkpoint(checkpoints)
        self._refuse_other_config(unpack(state["config"], tensors))
        modules = {name for name, thing in self.objects.items() if isinstance(thing, nn.Module)}
        if set(state["objects"]) != set(self.objects) - modules:
            raise UserError(
                f"{checkpoints}: holds the state of {sorted(state['objects'])}, but this program trains "
                f"{sorted(set(self.objects) - modules)}; resume with the code that wrote it or choose another run."
            )
        for name, thing in self.objects.items():
            if name in modules:
                load_module_state(thing, tensors, name)
            else:
                thing.load_state_dict(unpack(state["objects"][name], tensors))
        restore_random_state(unpack(state["random"], tensors), self.generators)
        if state["torch"] != torch.__version__:
            self._say(f"saved by torch {state['torch']}, going on with {torch.__version__}, so not bit for bit.")
        self._earlier_seconds, self._earlier_peak = state["seconds"], state["peak_memory_mb"]
        self.completed = self._saved = self._resumed_step = step

    def _refuse_other_config(self, saved: dict[str, Any]) -> None:
        changes = config_changes(saved, plain_config(self.config))
        if changes:
            raise UserError(
                f"{self.folder}: was trained with another config ({'; '.join(changes)}); "
                "choose another run name, or start over with --overwrite true."
            )

    def _refuse_non_finite(self, tensors: dict[str, Tensor]) -> None:
        """NaN anywhere, or an infinite weight, must not replace a good checkpoint."""
        modules = {name: thing for name, thing in self.objects.items() if isinstance(thing, nn.Module)}
        weights = {f"{name}.{key}" for name, module in modules.items() for key, _ in module.named_parameters()}
        bad = [
            name
            for name, tensor in tensors.items()
            if tensor.is_floating_point() and (tensor.isnan().any() or (name in weights and tensor.isinf().any()))
        ]
        if bad:
            raise UserError(
                f"{self.folder}: training broke down by step {self.completed}: {', '.join(bad)} not finite; "
                f"lower the learning rate. {self._how_to_go_on()}"
            )

    def _how_to_go_on(self) -> str:
        if self._saved > 0:
            return f"The checkpoint of step {self._saved} is intact: run the same command again to continue from there."
        return "No checkpoint had been written yet: run the same command again to start over."

    def _trim_metrics(self) -> None:
        """Drop lines of steps that will be done again (and a torn last line), so that every step appears once."""
        path = self.folder / METRICS
        if path.exists():
            kept = []
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True):
                try:
                    if json.loads(line)["step"] < self._resumed_step and line.endswith("\n"):
                        kept.append(line)
                except (ValueError, KeyError, TypeError):
                    continue
            temporary = path.with_name(f".{METRICS}.new")
            temporary.write_text("".join(kept), encoding="utf-8")
            os.replace(temporary, path)
        self._trimmed = True

    def _start_watching(self) -> None:
        if self.writes:
            self._progress = StepProgress(self.folder.name, self.completed, self.total_steps)
        if threading.current_thread() is threading.main_thread():  # Python allows signal handlers nowhere else
            for number in (signal.SIGINT, signal.SIGTERM):
                self._handlers[number] = signal.signal(number, self._on_signal)

    def _stop_watching(self) -> None:
        if self._progress is not None:
            self._progress.close()
            self._progress = None
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._handlers = {}

    def _on_signal(self, number: int, frame: Any) -> None:
        # os.write, because a handler that prints can interrupt another print half way.
        if self._signal is not None:
            os.write(2, b"\x1b[?25h" if sys.stderr.isatty() else b"")  # the progress bar hides the cursor
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        self._signal = number
        os.write(2, b"\nFinishing this step and saving; once more to stop at once.\n")

    def _say(self, sentence: str) -> None:
        if self.writes:
            say(f"{self.folder}: {sentence}")

    def _leave(self) -> None:
        name = signal.Signals(self._signal).name
        self._stop_watching()
        say(
            f"{self.folder}: stopped by {name} and saved after step {self.completed}; run the same command to continue."
        )
        raise SystemExit(128 + self._signal)


def begun_config(folder: Path, overwrite: bool = False) -> dict[str, Any] | None:
    """The stored config of a training that has saved something and is not to start over, else None.

    Raises UserError where it is empty or no mapping.
    """
    if overwrite or not checkpoint_steps(folder / CHECKPOINTS) or not (folder / CONFIG).is_file():
        return None
    stored = read_yaml(folder / CONFIG)
    if not isinstance(stored, dict) or not stored:
        raise UserError(f"{folder / CONFIG}: is damaged; restore it, or start over with --overwrite true")
    return stored


def run_folder(root: Path, name: str) -> Path:
    """Folder of the run called `name` under `root`; UserError when the name is not a plain, portable word."""
    if not RUN_NAME.fullmatch(name) or name.endswith(".") or name.split(".")[0].lower() in WINDOWS_DEVICES:
        raise UserError(
            f"name = {name!r} cannot name a run; use 1 to 64 letters, digits, '.', '_' or '-', "
            "starting with a letter or digit."
        )
    return root / name
