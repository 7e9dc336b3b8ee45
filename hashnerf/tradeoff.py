"""The trade-off of speed against accuracy: runs sweeps and writes their page and charts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hashnerf.command_line import nearest
from hashnerf.errors import UserError
from hashnerf.figure_style import png_bytes
from hashnerf.sweep import Sweep, load_sweep
from hashnerf.sweep_chart import sweep_chart
from hashnerf.sweep_page import page, sweep_section
from hashnerf.sweep_presets import chosen_presets, measured
from hashnerf.sweep_runs import Result, finished_rows, run_sweep
from hashnerf.whole_runs import whole_runs_section

PAGE = "speed_accuracy"


@dataclass(frozen=True)
class Tradeoff:
    """Which sweeps are run, and where the page goes."""

    sweeps: tuple[str, ...] = ()
    """Names of sweep files without `.yaml`; nothing: all."""
    folder: str = "configs/tradeoff"
    """Folder of the sweep files."""
    whole_runs: str = "configs/whole_runs.yaml"
    """File that names the reports of whole runs."""
    runs: str = "runs/tradeoff"
    """Where rows are trained, and keep their results."""
    out: str = "docs/results"
    """Where the page and its charts go."""
    workers: int = 1
    """Rows side by side; they share the cores, so that more than one makes all times longer."""
    most: int = 0
    """First rows of each sweep that are run; 0: all."""

    def __post_init__(self):
        if self.workers < 1:
            raise UserError(f"workers is {self.workers}; give at least 1")
        if self.most < 0:
            raise UserError(f"most is {self.most}; give a number of rows, or 0 for all")


def run_tradeoff(
    config: Tradeoff, scripts: Path, command: str, say: Callable[[str], None] = lambda line: print(line, flush=True)
) -> list[Result]:
    """Runs the asked sweeps, then writes the page of all sweeps that have rows; returns the rows that failed."""
    known = {path.stem: path for path in sorted(Path(config.folder).glob("*.yaml"))}
    for name in config.sweeps:
        if name not in known:
            raise UserError(f"sweeps: {name!r} is not in {config.folder}; {nearest(name, list(known))}")
    loaded = {name: load_sweep(path) for name, path in known.items()}  # all, before hours of work
    whole_runs_section(Path(config.whole_runs))
    failed = []
    for name in config.sweeps or known:
        results = run_sweep(loaded[name], Path(config.runs), scripts, config.workers, say, config.most)
        failed += [one for one in results if one.reason]
    found = [(sweep, finished_rows(sweep, Path(config.runs), scripts)) for sweep in loaded.values()]
    write_page([one for one in found if one[1]], config, command)
    return failed


def write_page(found: Sequence[tuple[Sweep, Sequence[Result]]], config: Tradeoff, command: str) -> None:
    """Writes the page and one chart a sweep into `config.out`."""
    out, sections = Path(config.out), []
    out.mkdir(parents=True, exist_ok=True)
    for sweep, results in found:
        picture = f"{PAGE}_{sweep.name}.png"
        if measured(sweep, results):
            (out / picture).write_bytes(png_bytes(sweep_chart(sweep, results, chosen_presets(sweep, results))))
        sections.append(sweep_section(sweep, results, picture))
    text = page(sections, command, whole_runs_section(Path(config.whole_runs)))
    (out / f"{PAGE}.md").write_text(text, encoding="utf-8")
