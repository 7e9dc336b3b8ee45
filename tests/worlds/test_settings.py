import pytest

from hashnerf.errors import UserError
from worlds.settings import EgoCameraConfig, SplitConfig


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: EgoCameraConfig(field_of_view=180.0), "ego_camera.field_of_view = 180.0 is out of range"),
        (lambda: EgoCameraConfig(height=0.5), "ego_camera.height = 0.5 is out of range"),
        (lambda: SplitConfig(test_every=50), "splits.test_every = 50 is out of range; give a number from 3 to 8"),
        (lambda: SplitConfig(birds_eye="val"), "splits.birds_eye = 'val' is not known; give one of train, test"),
    ],
)
def test_settings_out_of_range_are_one_sentence(make, sentence):
    with pytest.raises(UserError, match=sentence):
        make()
