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


def about(name: str, arguments: list[str]) -> str:
    """What the head of a page says of where its figures come from."""
    return f"`{shlex.join(['python', 'scripts/benchmark.py', name, *arguments])}`; seed 0; {machine()}; {commit()}."


def capacity(arguments: list[str]) -> None:
    """Fit five scenes with derived and with fixed capacity and write the page."""
    config = parse_config(CapacityStudy, arguments, description="Measure what derived capacity is worth.")
    capacity_study.write_study(capacity_study.run_study(config), config, about("capacity", arguments))


def photographs(arguments: list[str]) -> None:
    """Fit real photographs at several sizes and lengths and write the page."""
    config = parse_config(PhotographStudy, arguments, description="Measure quality against seconds on photographs.")
    command = shlex.join(["python", "scripts/benchmark.py", "photographs", *arguments])
    photograph_study.write_study(
        photograph_study.run_study(config), config, f"`{command}`; seed 0; {machine()}; {commit()}."
    )


BENCHMARKS: dict[str, Callable[[list[str]], int | None]] = {
    "encoding": encoding,
    "tradeoff": tradeoff,
    "capacity": capacity,
    "photographs": photographs,
}


def main() -> int | None:
    """Run the benchmark that the first argument names."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in BENCHMARKS:
        raise UserError(f"{name or 'nothing'}: is no benchmark; say python scripts/benchmark.py {'|'.join(BENCHMARKS)}")
    status = BENCHMARKS[name](sys.argv[2:])
    print(f"\n`python scripts/benchmark.py {' '.join(sys.argv[1:])}`; {machine()}; {commit()}.")
    return status


if __name__ == "__main__":
    run_main(main)
