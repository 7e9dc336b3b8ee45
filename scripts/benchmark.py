"""What the core costs on this machine.

python scripts/benchmark.py encoding                 # the hash-grid encoding beside the usual one
python scripts/benchmark.py encoding --device cuda
python scripts/benchmark.py tradeoff                 # speed against accuracy: docs/results/speed_accuracy.md
python scripts/benchmark.py tradeoff --sweeps '[field]' --most 2
python scripts/benchmark.py capacity --photographs FOLDER    # what derived capacity is worth: docs/results/capacity.md
python scripts/benchmark.py photographs --data FOLDER        # quality against seconds: docs/results/photographs.md
"""

import shlex
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from hashnerf import capacity_study, photograph_study
from hashnerf.capacity_study import CapacityStudy
from hashnerf.command_line import parse_config, run_main, set_threads
from hashnerf.encoding_benchmark import EncodingBenchmark, encoding_table, time_encodings
from hashnerf.errors import UserError
from hashnerf.photograph_study import PhotographStudy
from hashnerf.results_page import table_lines
from hashnerf.run_info import commit, machine
from hashnerf.tradeoff import Tradeoff, run_tradeoff

SCRIPTS = Path(__file__).resolve().parent


def encoding(arguments: list[str]) -> None:
    """Time the encoding and print the table."""
    config = parse_config(EncodingBenchmark, arguments, description="Time the hash-grid encoding.")
    set_threads(0)
    print("\n".join(table_lines(encoding_table(time_encodings(config)))))


def tradeoff(arguments: list[str]) -> int:
    """Run the sweeps and write their page; 1 where a row failed."""
    config = parse_config(Tradeoff, arguments, description="Measure speed against accuracy.")
    command = shlex.join(["python", "scripts/benchmark.py", "tradeoff", *arguments])
    failed = run_tradeoff(config, SCRIPTS, command)
    for one in failed:
        print(f"{one.row.name} failed: {one.reason}", file=sys.stderr)
    return 1 if failed else 0


def study(name: str, arguments: list[str]) -> None:
    """Run the study of that name and write its page."""
    config_class, part, description = STUDIES[name]
    config = parse_config(config_class, arguments, description=description)
    told = [Path(word).name if Path(word).is_absolute() else word for word in arguments]  # where data lie is private
    command = shlex.join(["python", "scripts/benchmark.py", name, *told])
    part.write_study(part.run_study(config), config, f"`{command}`; {machine()}; {commit()}.")


STUDIES = {
    "capacity": (CapacityStudy, capacity_study, "Measure what derived capacity is worth."),
    "photographs": (PhotographStudy, photograph_study, "Measure quality against seconds on real photographs."),
}
BENCHMARKS: dict[str, Callable[[list[str]], int | None]] = {
    "encoding": encoding,
    "tradeoff": tradeoff,
    **{name: partial(study, name) for name in STUDIES},
}


def main() -> int | None:
    """Run the benchmark that the first argument names."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name in ("-h", "--help"):
        return print(f"{__doc__}\nEach answers --help.")
    if name not in BENCHMARKS:
        raise UserError(f"{name or 'nothing'}: is no benchmark; say python scripts/benchmark.py {'|'.join(BENCHMARKS)}")
    status = BENCHMARKS[name](sys.argv[2:])
    print(f"\n`python scripts/benchmark.py {' '.join(sys.argv[1:])}`; {machine()}; {commit()}.")
    return status


if __name__ == "__main__":
    run_main(main)
