"""closed_loop.json: what was driven is what is read."""

import pytest

from carff.closed_loop_file import CLOSED_LOOP, ClosedLoop, load_closed_loop, save_closed_loop
from carff.planning_metrics import ApproachPoint, Episode
from hashnerf.errors import UserError

DRIVEN = ClosedLoop(
    (
        Episode("risk", 1, True, False, True, False, 5.25, 9),
        Episode("always_go", 1, True, True, False, False, None, 2),
    ),
    (ApproachPoint(1, 0, 8.2, "hidden", 0.5, False),),
    {"samples": 10, "seed": 3},
)


def test_a_round_trip(tmp_path):
    save_closed_loop(tmp_path, DRIVEN)
    assert load_closed_loop(tmp_path) == DRIVEN


def test_a_reason_instead_of_episodes(tmp_path):
    save_closed_loop(tmp_path, ClosedLoop(reason="nothing drives here"))
    assert load_closed_loop(tmp_path).reason == "nothing drives here"


def test_a_missing_file_names_the_command(tmp_path):
    assert load_closed_loop(tmp_path).reason == f"not driven yet: run scripts/plan_carla.py --run {tmp_path}"


@pytest.mark.parametrize(
    "text", ["{}", '{"about": {}, "reason": "", "approach": [], "episodes": [{"go": 1}]}', "not json"]
)
def test_a_foreign_file_is_refused(tmp_path, text):
    (tmp_path / CLOSED_LOOP).write_text(text)
    with pytest.raises(UserError, match="closed_loop"):
        load_closed_loop(tmp_path)
