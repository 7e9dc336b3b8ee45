"""The header of a report."""

from carff.config import CarffConfig
from carff.run_info import describe_run


def test_the_header_names_run_preset_and_seed():
    info = describe_run(CarffConfig(name="mine", seed=7), "intersection", "python scripts/x.py --name 'a b'")
    assert (info.name, info.seed, info.scenario, info.preset) == ("mine", 7, "intersection", "fast")
