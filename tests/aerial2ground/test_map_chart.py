import numpy as np
import torch

from aerial2ground.map_chart import MARGIN, draw_map, draw_misses, draw_road
from aerial2ground.road_network import RoadNetwork
from hashnerf.figure_style import new_figure


def axes():
    return new_figure(2.0, 2.0).subplots()


def test_a_road_is_a_band_of_its_width_with_round_ends():
    here = axes()
    draw_road(here, np.array([[0.0, 0.0], [2.0, 0.0]]), 0.7)
    (band,) = here.collections
    boxes = [path.get_extents() for path in band.get_paths()]
    assert min(box.y0 for box in boxes) == -0.35 and max(box.y1 for box in boxes) == 0.35
    assert max(box.x1 for box in boxes) == 2.35


def test_the_map_shows_roads_and_what_is_to_be_seen():
    network = RoadNetwork((torch.tensor([[0.0, 0.0], [2.0, 0.0]]),), 0.6, 0.0, torch.zeros(1, 3))
    here = axes()
    draw_map(here, network, [np.array([[1.0, 3.0]])], "town")
    np.testing.assert_allclose(here.get_xlim(), (-0.3 - MARGIN, 2.3 + MARGIN), atol=1e-6)
    np.testing.assert_allclose(here.get_ylim(), (-0.3 - MARGIN, 3.0 + MARGIN), atol=1e-6)
    draw_map(axes(), None, [], "nothing known")


def test_every_miss_is_a_line_from_the_truth():
    here = axes()
    draw_misses(here, np.array([[0.0, 0.0, 0.0]]), np.array([[1.0, 2.0, 0.0]]), "#000000")
    assert here.collections[0].get_segments()[0].tolist() == [[0.0, 0.0], [1.0, 2.0]]
