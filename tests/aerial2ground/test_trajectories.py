"""Paths of a data set: on the roads, or refused in one sentence."""

import numpy as np
import pytest
import torch

from aerial2ground.road_network import read_road_network
from aerial2ground.trajectories import read_trajectories
from hashnerf.errors import UserError

ZERO = torch.zeros(3, dtype=torch.float64)
ROADS = read_road_network({"lines": [[[0, 0], [4, 0]]], "width": 1.0, "colour": [9, 9, 9]}, ZERO, "x")


def test_paths_in_the_frame_of_the_poses():
    origin = torch.tensor([10.0, 20.0, 0.0], dtype=torch.float64)
    roads = read_road_network({"lines": [[[10, 20], [14, 20]]], "width": 1.0, "colour": [9, 9, 9]}, origin, "x")
    paths = read_trajectories({"there": [[10, 20.2], [14, 20.2]]}, roads, origin, "x")
    assert np.allclose(paths["there"].points, [[0, 0.2], [4, 0.2]])


@pytest.mark.parametrize(
    "entry, sentence",
    [
        (None, "has no trajectories"),
        ({}, "has no trajectories"),
        ({"a": [[0, 0], [1, "x"]]}, "trajectories.a must be points"),
        ({"a": [[0, 0, 0], [1, 1, 1]]}, "trajectories.a must be points"),
        ({"a": [[0, 0], [1, float("nan")]]}, "trajectories.a must be points"),
        ({"a": [[1e300, 0], [-1e300, 0]]}, "trajectories.a leaves the road network"),
        ({"../evil": [[0, 0], [4, 0]]}, r"trajectories holds the name '../evil'; use 1 to 64 letters"),
        ({"/elsewhere/evil": [[0, 0], [4, 0]]}, "trajectories holds the name '/elsewhere/evil'"),
        ({"": [[0, 0], [4, 0]]}, "trajectories holds the name ''"),
        ({"a": [[0, 0], [0, 0]]}, "trajectories.a: a path needs two or more points"),
        ({"a": [[0, 0], [4, 0], [4, 3]]}, r"trajectories.a leaves the road network at \[4.00, 3.00\]"),
    ],
)
def test_what_cannot_be_driven_is_named(entry, sentence):
    with pytest.raises(UserError, match=f"town.json: .*{sentence}|town.json: {sentence}"):
        read_trajectories(entry, ROADS, ZERO, "town.json")
