import numpy as np
import pytest

from hashnerf.errors import UserError
from worlds.meshes import Material, block
from worlds.raycast import Caster
from worlds.shading import BOUNCE, SKY, SUN, FaceLight, Light, mottle, sky_colour, to_uint8


def test_sun_direction():
    # Azimuth 90 is +y; at elevation 30 the height is sin 30 = 1/2.
    np.testing.assert_allclose(Light(azimuth=90.0, elevation=30.0).direction, [0, np.sqrt(3) / 2, 0.5], atol=1e-6)


def test_face_light_by_hand():
    caster = Caster([(1, block((0, 0, 0), (1, 1, 1), Material((0.5, 0.5, 0.5))))])
    light = FaceLight(caster, Light(azimuth=0.0, elevation=30.0))
    top, east, west = (
        np.flatnonzero(caster.normal @ np.array(n) > 0.99)[0] for n in ([0, 0, 1], [1, 0, 0], [-1, 0, 0])
    )
    np.testing.assert_allclose(light.sun[top], 0.5 * 0.5 * SUN, rtol=1e-5)
    np.testing.assert_allclose(light.sun[east], 0.5 * np.cos(np.pi / 6) * SUN, rtol=1e-5)
    np.testing.assert_array_equal(light.sun[west], 0)
    assert light.sunlit[top] and light.sunlit[east] and not light.sunlit[west]
    np.testing.assert_allclose(light.ambient[top], 0.5 * SKY, rtol=1e-5)
    np.testing.assert_allclose(light.ambient[west], 0.25 * (SKY + BOUNCE), rtol=1e-5)


def test_sky_is_a_function_of_height_only_and_continuous_at_the_horizon():
    angle = np.linspace(0, 6, 20, dtype=np.float32)
    ring = np.stack([np.cos(angle) * 0.8, np.sin(angle) * 0.8, np.full(20, 0.6, np.float32)], 1)
    assert np.ptp(sky_colour(ring), axis=0).max() == 0
    low = np.array([[1, 0, -1e-6], [1, 0, 1e-6]], np.float32)
    assert np.abs(np.diff(sky_colour(low), axis=0)).max() < 1e-2


def test_mottle_stays_in_range_and_is_smooth():
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, (20000, 3)).astype(np.float32)
    value = mottle(points)
    assert np.abs(value).max() <= 1.0 and value.std() > 0.2
    # 10 cm further on it has changed little: no white noise.
    assert np.abs(mottle(points + np.float32(0.1)) - value).max() < 0.6


def test_to_uint8_is_monotonic_and_bounded():
    ramp = np.linspace(0, 50, 4000, dtype=np.float32)[:, None].repeat(3, 1)
    value = to_uint8(ramp)
    assert value[0].tolist() == [0, 0, 0] and value[-1].tolist() == [255, 255, 255]
    assert (np.diff(value[:, 0].astype(int)) >= 0).all()


@pytest.mark.parametrize(("key", "value"), [("azimuth", 400.0), ("elevation", 5.0), ("elevation", float("nan"))])
def test_settings_out_of_range_are_refused(key, value):
    with pytest.raises(UserError, match=f"light.{key} = .* is out of range; give a number from"):
        Light(**{key: value})
