"""The front against a slow, obviously right one; worked breaks of monotonicity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hashnerf.errors import UserError
from hashnerf.pareto import dominated, monotonicity_violations, pareto_front

# few different values, so that equal columns and equal points are common
POINTS = st.tuples(st.integers(0, 12), st.integers(1, 3)).flatmap(
    lambda shape: arrays(float, shape, elements=st.sampled_from([-2.0, -0.5, 0.0, 1.0, 3.0]))
)


def slowly_dominated(points: np.ndarray) -> list[bool]:
    def beats(a, b):
        return all(x <= y for x, y in zip(a, b)) and any(x < y for x, y in zip(a, b))

    return [any(beats(other, point) for other in points) for point in points]


@given(POINTS)
def test_dominated_points_are_those_of_the_definition(points):
    assert dominated(points).tolist() == slowly_dominated(points)


@given(POINTS)
def test_the_front_holds_every_undominated_point_once_and_nothing_else(points):
    front = pareto_front(points)
    kept = {tuple(points[row]) for row in front}
    assert len(kept) == len(front)
    assert kept == {tuple(point) for point, worse in zip(points, slowly_dominated(points)) if not worse}
    assert (np.diff(points[front, 0]) >= 0).all()
    assert not dominated(points[front]).any()


def test_a_front_worked_by_hand():
    # cost and loss: c is dearer and no better than b, d is as dear as b and worse, the second a is the first again
    points = np.array([[3.0, 1.0], [1.0, 5.0], [2.0, 2.0], [4.0, 2.0], [2.0, 3.0], [1.0, 5.0]])
    assert pareto_front(points).tolist() == [1, 2, 0]


def test_points_that_are_no_numbers_are_refused():
    with pytest.raises(UserError, match="not finite"):
        dominated(np.array([[1.0, np.nan]]))


def test_a_dearer_point_may_be_worse_by_chance_alone():
    cost, loss = np.array([4.0, 1.0, 2.0, 2.0]), np.array([2.05, 3.0, 2.0, 2.5])
    assert monotonicity_violations(cost, loss, 0.1) == []
    # only the dearest breaks the rule, against the best of the cheaper ones; equal costs are not compared
    assert monotonicity_violations(cost, loss, 0.01) == [(2, 0)]
    assert monotonicity_violations(cost, np.array([2.0, 2.0, 2.0, 2.0]), 0.0) == []
    with pytest.raises(UserError, match="noise is -1"):
        monotonicity_violations(cost, loss, -1.0)


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=10), st.sampled_from([0.0, 1.0, 2.0]))
def test_a_violation_is_found_exactly_where_one_is(pairs, noise):
    cost, loss = (np.array([float(pair[i]) for pair in pairs]) for i in (0, 1))
    slow = {
        j for j in range(len(pairs)) if any(cost[i] < cost[j] and loss[j] > loss[i] + noise for i in range(len(pairs)))
    }
    found = monotonicity_violations(cost, loss, noise)
    assert {dearer for _, dearer in found} == slow and len(found) == len(slow)
    assert all(cost[cheaper] < cost[dearer] and loss[dearer] > loss[cheaper] + noise for cheaper, dearer in found)
