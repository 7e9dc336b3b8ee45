import numpy as np
import pytest

from hashnerf.unit_pictures import unit_pictures


@pytest.mark.parametrize("level", [2.0, 255.0, -0.5, np.nan, np.inf])
def test_a_wrong_range_is_refused(level):
    with pytest.raises(ValueError, match=r"floats in \[0, 1\]"):
        unit_pictures(np.stack([np.full((4, 4, 3), value) for value in (0.5, level)]))


def test_integers_and_floats_of_the_same_picture_agree():
    levels = np.arange(256, dtype=np.uint8).repeat(3).reshape(16, 16, 3)
    np.testing.assert_allclose(unit_pictures(levels), unit_pictures((levels / 255).astype(np.float32)), atol=1e-7)
    assert unit_pictures(levels).max() == 1.0
