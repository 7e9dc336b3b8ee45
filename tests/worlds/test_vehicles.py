import numpy as np
import pytest

from worlds.raycast import Caster
from worlds.vehicles import box_truck, sedan, van

CASES = [(sedan, (4.5, 1.8, 1.42)), (sedan, (3.6, 1.7, 1.5)), (van, (5.2, 2.0, 2.45)), (box_truck, (6.0, 2.4, 2.8))]


@pytest.mark.parametrize(("make", "size"), CASES)
def test_body_fills_its_box(make, size):
    length, width, height = size
    expected = [[-length / 2, -width / 2, 0], [length / 2, width / 2, height]]
    np.testing.assert_allclose(make(size, (0.5, 0.1, 0.1)).bounds, expected, atol=1e-6)


@pytest.mark.parametrize(("make", "size"), CASES)
def test_no_two_panels_of_different_colour_share_a_plane(make, size):
    # Where they do, the colour that a ray finds depends on rounding: start the ray elsewhere and it changes.
    caster = Caster([(1, make(size, (0.5, 0.1, 0.1)))])
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    targets = rng.uniform(-0.5, 0.5, (20000, 3)) * size + [0, 0, size[2] / 2]
    colours = []
    for distance in (8.0, 9.7, 11.3):
        origins = (targets - distance * directions).astype(np.float32)
        _, face = caster.cast(origins, directions.astype(np.float32))
        colours.append(np.where(face[:, None] >= 0, caster.mesh.colour[face], -1))
    same = np.all(colours[0] == colours[1], 1) & np.all(colours[0] == colours[2], 1)
    assert same.mean() > 0.998
