"""What the header of a CARFF report says about its run."""

from carff.config import CarffConfig
from hashnerf.run_info import RunInfo, run_info_now


def describe_run(config: CarffConfig, scenario: str, command: str) -> RunInfo:
    """Returns the header of a report written now, on this machine."""
    return run_info_now(config.name, config.evaluation.preset, scenario, command, config.seed)
