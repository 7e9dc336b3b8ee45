"""What cameras see of a box: by hand for cameras that look straight down."""

import torch

from hashnerf.cameras import Cameras, look_at
from hashnerf.visible_volume import LATTICE, box_lattice, visible_box, visible_points

BOX = torch.tensor([[-12.0, -12.0, 0.0], [12.0, 12.0, 1.0]])


def downward(*places: tuple[float, float]) -> Cameras:
    """Cameras 6 m above the ground that see 90 degrees: from x - 6 to x + 6 at z = 0."""
    poses = torch.stack([look_at((x, y, 6.0), (x, y, 0.0), (0.0, 1.0, 0.0)) for x, y in places])
    count = len(places)
    return Cameras(poses, torch.full((count, 2), 10.0), torch.full((count, 2), 10.0), torch.zeros(count, 4), 20, 20)


def test_a_lattice_holds_the_middles_of_the_cells():
    points = box_lattice(torch.tensor([[0.0, 0.0, 0.0], [4.0, 2.0, 8.0]]), 2)
    assert len(points) == 8
    assert points[0].tolist() == [1.0, 0.5, 2.0] and points[-1].tolist() == [3.0, 1.5, 6.0]


def test_a_point_is_seen_inside_the_picture_and_its_depth_is_along_the_axis():
    points = torch.tensor([[5.9, 0.0, 0.0], [6.1, 0.0, 0.0], [0.0, 0.0, 7.0], [2.9, 0.0, 3.0], [3.1, 0.0, 3.0]])
    seen, depth = visible_points(downward((0.0, 0.0)), points)
    assert seen.tolist() == [[True, False, False, True, False]]
    assert torch.allclose(depth[0], torch.tensor([6.0, 6.0, -1.0, 3.0, 3.0]))


def test_the_box_is_trimmed_to_what_two_cameras_share():
    # cameras at x = -2 and 2: the ground from -4 to 4 is in both pictures, y from -6 to 6
    box = visible_box(downward((-2.0, 0.0), (2.0, 0.0)), BOX)
    cell = 24 / LATTICE
    assert torch.allclose(box[:, 0], torch.tensor([-4.0, 4.0]), atol=cell)
    assert torch.allclose(box[:, 1], torch.tensor([-6.0, 6.0]), atol=cell)
    assert box[:, 2].tolist() == [0.0, 1.0]


def test_one_camera_is_enough_if_there_is_but_one():
    assert torch.allclose(visible_box(downward((0.0, 0.0)), BOX)[:, 0], torch.tensor([-6.0, 6.0]), atol=24 / LATTICE)


def test_a_box_that_nobody_sees_stays():
    away = BOX + torch.tensor([100.0, 0.0, 0.0])
    assert torch.equal(visible_box(downward((0.0, 0.0), (1.0, 0.0)), away), away)
