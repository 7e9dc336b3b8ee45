"""Plant one small fault after the other in the guard, run its tests, and list the faults that they do not notice.

python scripts/mutate_guard.py
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path

from hashnerf.command_line import parse_config, run_main
from hashnerf.errors import UserError
from hashnerf.mutation_run import ERROR, SURVIVED, Limits, MutationResult, plan_mutants, run_mutants
from hashnerf.progress import StepProgress
from hashnerf.run_info import commit, machine

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class MutateConfig:
    """What is mutated, and which tests should notice."""

    files: str = "aerial2ground/guard/*.py"
    """Pattern of the mutated files, from the root of the repository."""
    tests: str = "tests/aerial2ground/guard"
    """Folder or file of tests."""
    out: Path = Path("runs/bridge_evidence/mutants.json")
    """Where the result is written."""
    workers: int = 2
    """Mutants tried at the same time."""
    sample: float = 1.0
    """Share of the mutants that is tried, chosen at random; below 1 for a quick look."""
    seed: int = 0
    """Of that choice."""
    required: float = 0.95
    """Share of the mutants that must be noticed."""

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise UserError(f"workers is {self.workers}; give at least 1")
        for key in ("sample", "required"):
            if not 0 < getattr(self, key) <= 1:
                raise UserError(f"{key} is {getattr(self, key)}; give a share above 0 and up to 1")


def main() -> int:
    """Try the mutants; exit code 1 where too many go unnoticed."""
    config = parse_config(MutateConfig, description="Mutate the guard and see whether its tests notice.")
    files = [path.relative_to(ROOT).as_posix() for path in sorted(ROOT.glob(config.files))]
    planned = plan_mutants(ROOT, files, config.sample, config.seed)
    begun, tried = time.monotonic(), []
    progress = StepProgress("mutants", 0, len(planned))
    for one in run_mutants(ROOT, planned, config.tests, Limits(config.workers)):
        tried.append(one)
        progress.show(len(tried))
        if one.outcome in (SURVIVED, ERROR):
            print(f"{one.file}:{one.line}: {one.outcome}: {one.before}  ->  {one.after}", flush=True)
    progress.close()
    result = MutationResult(tuple(tried))
    about = {"commit": commit(), "machine": machine(), "seconds": round(time.monotonic() - begun, 1)}
    about |= {"sample": config.sample, "seed": config.seed, "required": config.required, "tests": config.tests}
    config.out.parent.mkdir(parents=True, exist_ok=True)
    config.out.write_text(json.dumps(about | result.as_json(), indent=1) + "\n", encoding="utf-8")
    counts = ", ".join(f"{count} {name}" for name, count in result.counts.items())
    print(f"{config.out}: {len(tried)} mutants, {counts}; {result.killed_share:.1%} noticed")
    return int(result.killed_share < config.required)


if __name__ == "__main__":
    run_main(main)
