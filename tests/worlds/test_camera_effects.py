"""Camera effects one at a time."""

import numpy as np
import pytest

from hashnerf.errors import UserError
from worlds.camera_effects import CameraEffects, DepthEffects, blurred, depth_measured, photographed

GREY = np.full((20, 30, 3), 100, np.uint8)


def shot(picture=GREY, pixels_per_second=0.0, **effects):
    return photographed(picture, CameraEffects(**effects), pixels_per_second, np.random.default_rng(0))


def test_no_effect_changes_nothing():
    picture = np.random.default_rng(1).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    assert np.array_equal(shot(picture, 500.0), picture)


def test_a_stop_doubles_the_light():
    assert (shot(exposure=1.0) == round(100 * 2 ** (1 / 2.2))).all() and (shot(exposure=3.0) == 255).all()


def test_warmth_raises_red_and_lowers_blue():
    assert shot(warmth=0.1)[0, 0].tolist() == [round(100 * 1.1 ** (1 / 2.2)), 100, round(100 * 0.9 ** (1 / 2.2))]


def test_noise_has_the_spread_asked_for():
    noisy = shot(np.full((200, 200, 3), 128, np.uint8), noise=0.02).astype(float)
    assert noisy.std() == pytest.approx(0.02 * 255, rel=0.05) and noisy.mean() == pytest.approx(128, abs=0.2)


def test_blur_spreads_a_line_sideways_and_keeps_its_light():
    light = np.zeros((3, 31, 3), np.float32)
    light[:, 15] = 1.0
    spread = blurred(light, 4.0)
    assert spread.sum() == pytest.approx(light.sum()) and (spread > 0)[0, :, 0].sum() == 5
    assert spread[0, 15, 0] == pytest.approx(0.25) and np.array_equal(spread, spread[:, ::-1])
    assert blurred(light, 0.0) is light
    moving = shot(np.uint8(light * 255), pixels_per_second=-200.0, shutter=0.02)
    assert (moving[0, :, 0] > 0).sum() == 5


def measured(depth, **effects):
    return depth_measured(depth, DepthEffects(**effects), np.random.default_rng(0))


def test_no_effect_on_depth_changes_nothing():
    depth = np.random.default_rng(1).uniform(0.1, 20, (20, 30)).astype(np.float32)
    depth[0] = 0
    assert np.allclose(measured(depth), depth, rtol=1e-6) and (measured(depth)[0] == 0).all()


@pytest.mark.parametrize("metres, spread", [(1.0, 0.005), (2.0, 0.02), (4.0, 0.08)])
def test_the_error_of_depth_grows_with_its_square(metres, spread):
    # d(1 / x) = -dx / x^2, so a spread of 0.005 in 1 / depth is one of 0.005 x^2 in depth
    found = measured(np.full((200, 200), metres, np.float32), noise=0.005)
    assert found.std() == pytest.approx(spread, rel=0.03) and np.median(found) == pytest.approx(metres, rel=1e-3)


def test_holes_and_what_is_too_far_are_nothing():
    found = measured(np.full((200, 200), 2.0, np.float32), holes=0.1)
    assert (found == 0).mean() == pytest.approx(0.1, abs=0.01) and (found[found > 0] == 2).all()
    far = measured(np.full((200, 200), 1e6, np.float32), noise=0.005)
    assert (far == 0).mean() == pytest.approx(0.5, abs=0.01) and np.isfinite(far).all() and (far >= 0).all()
    assert (measured(np.ones((3, 3), np.float32), holes=1.0) == 0).all()


@pytest.mark.parametrize("effects", [{"noise": -0.1}, {"noise": float("nan")}, {"holes": 1.1}])
def test_effects_on_depth_out_of_range_are_refused(effects):
    with pytest.raises(UserError, match="depth"):
        DepthEffects(**effects)


@pytest.mark.parametrize("effects", [{"exposure": 9.0}, {"warmth": 1.0}, {"noise": -0.1}, {"shutter": 1.0}])
def test_effects_out_of_range_are_refused(effects):
    with pytest.raises(UserError, match="camera"):
        CameraEffects(**effects)
