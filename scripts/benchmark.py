"""What the core costs on this machine.

python scripts/benchmark.py encoding                 # the hash-grid encoding beside the usual one
python scripts/benchmark.py encoding --device cuda
"""

import sys
from collections.abc import Callable

from hashnerf.command_line import parse_config, run_main, set_threads
from hashnerf.encoding_benchmark import EncodingBenchmark, encoding_table, time_encodings
from hashnerf.errors import UserError
from hashnerf.results_page import table_lines
from hashnerf.run_info import commit, machine


def encoding(arguments: list[str]) -> None:
    """Time the encoding and print the table."""
    config = parse_config(EncodingBenchmark, arguments, description="Time the hash-grid encoding.")
    set_threads(0)
    print("\n".join(table_lines(encoding_table(time_encodings(config)))))


BENCHMARKS: dict[str, Callable[[list[str]], None]] = {"encoding": encoding}


def main() -> None:
    """Run the benchmark that the first argument names."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in BENCHMARKS:
        raise UserError(f"{name or 'nothing'}: is no benchmark; say python scripts/benchmark.py {'|'.join(BENCHMARKS)}")
    BENCHMARKS[name](sys.argv[2:])
    print(f"\n`python scripts/benchmark.py {' '.join(sys.argv[1:])}`; {machine()}; {commit()}.")


if __name__ == "__main__":
    run_main(main)
