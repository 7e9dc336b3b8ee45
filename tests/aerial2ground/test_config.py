"""The config of the pipeline and the presets that come with it."""

from pathlib import Path

import pytest

from aerial2ground.config import AerialConfig, PicturesConfig
from hashnerf.command_line import load_config
from hashnerf.errors import UserError

FOLDER = Path(__file__).resolve().parents[2] / "configs" / "aerial2ground"
PRESETS = [path for path in sorted(FOLDER.glob("*.yaml")) if not path.stem.startswith("recording")]


@pytest.mark.parametrize("preset", PRESETS, ids=lambda path: path.stem)
def test_presets_load(preset):
    config = load_config(AerialConfig, preset)
    assert config.folder == Path("runs") / config.name and config.dataset.startswith("data/")


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"scene_box": (0.0, 0.0, 0.0, 1.0, 1.0)}, "scene_box is"),
        ({"scene_box": (0.0, 0.0, 5.0, 1.0, 1.0, 2.0)}, "with x0 < x1"),
        ({"scene_box": (0.0, 0.0, 0.0)}, "scene_box is"),
        ({"test_every": 1}, "test_every is 1"),
        ({"test_every": -8}, "test_every is -8"),
    ],
)
def test_bad_settings_are_named(changes, sentence):
    with pytest.raises(UserError, match=sentence):
        AerialConfig(**changes)


def test_the_run_on_collected_pictures_is_one_without_road_prior(tmp_path):
    told = PicturesConfig(runs=str(tmp_path), name="town", pictures="drives", road_network="roads.json")
    with pytest.raises(UserError, match=r"town/drives: no collected pictures here; run scripts/collect_drives"):
        _ = told.source
    told.drives.mkdir(parents=True)
    (told.drives / "transforms.json").write_text("{}")
    source = told.source
    assert type(source) is AerialConfig and source.folder == told.folder / "from_drives"
    assert source.dataset == str(told.drives) and source.road_network == ""
    assert source.reconstruction.road_prior.share == 0 and not source.reconstruction.refine_poses
    assert PicturesConfig(runs=str(tmp_path), name="town").source.folder == told.folder
