"""Every test runs on one thread and from the same seeds, so that a failure repeats; no test is judged by its speed."""

import json
from collections.abc import Callable, Iterator

import pytest
import torch
from hypothesis import HealthCheck, settings

from hashnerf.random_state import seed_everything

torch.set_num_threads(1)
settings.register_profile("house", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("house")


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--autocast bfloat16` or `--autocast float16` runs the numbered rows as a user's autocast would run the code."""
    parser.addoption("--autocast", choices=("bfloat16", "float16"), help="run the numbered rows under autocast")


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Start each test from the same random numbers, whatever ran before it."""
    seed_everything(0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the tests that measure numbered rows: `pytest -m numeric`, or `-m bridge`, runs them alone."""
    for item in items:
        for fixture, marker in (("numeric_row", pytest.mark.numeric), ("bridge_row", pytest.mark.bridge)):
            if fixture in getattr(item, "fixturenames", ()):
                item.add_marker(marker)


@pytest.fixture(autouse=True)
def autocast(request: pytest.FixtureRequest) -> Iterator[None]:
    """Runs a numbered row under the autocast asked for: what must stay float32 stays so, whatever users put around.

    Without autocast's cache of cast weights: whole trainings run in here, and the cache would go on handing out weights
    from before their first step. Trainings of the project turn autocast off for themselves, with the cache or without.
    """
    asked = request.config.getoption("autocast")
    if not asked or not request.node.get_closest_marker("numeric"):
        yield
        return
    with torch.autocast("cpu", dtype=getattr(torch, asked), cache_enabled=False):
        yield


@pytest.fixture
def numeric_row(
    request: pytest.FixtureRequest, record_property: Callable[[str, object], None]
) -> Callable[[str, str, float, float], None]:
    """Measures a row of docs/results/numerics.md: its number, what was put in, the worst error, and what is accepted.

    The row's number stands in the test's name. Where a row says yes or no, the error is the number of cases that say
    no, and none is accepted. Several inputs of one row are several calls.
    """

    def measure(row: str, inputs: str, worst: float, accepted: float = 0.0) -> None:
        assert row.lower() in request.node.originalname.split("_"), f"{row} is missing in the name of the test"
        record_property("numeric_row", json.dumps([row, inputs, float(worst), float(accepted)]))
        assert worst <= accepted, f"{row}, {inputs}: {worst} is more than {accepted}"

    return measure


@pytest.fixture
def bridge_row(request: pytest.FixtureRequest, record_property: Callable[[str, object], None]) -> Callable[..., None]:
    """Measures a requirement of docs/results/bridge.md: its number, what was done, the figure, the most allowed, unit.

    The requirement's number stands in the test's name. Where it says yes or no, the figure is the number of violations.
    `slack` times as much still passes: for times that are measured while other tests run beside.
    """

    def measure(row: str, what: str, measured: float, required: float, unit: str = "", slack: float = 1.0) -> None:
        assert row.lower() in request.node.originalname.split("_"), f"{row} is missing in the name of the test"
        record_property("bridge_row", json.dumps([row, what, float(measured), float(required), unit]))
        assert measured <= required * slack, f"{row}, {what}: {measured} {unit} is more than {required}"

    return measure
