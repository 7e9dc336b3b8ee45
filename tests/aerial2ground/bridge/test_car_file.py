"""Car files that are right, and one sentence for each way to get them wrong."""

import math
import subprocess
import sys
from pathlib import Path

import pytest

from aerial2ground.bridge.car_file import CameraCalibration, load_car
from aerial2ground.car import CarConfig
from aerial2ground.guard.actuation import Actuation
from hashnerf.errors import UserError

ROOT = Path(__file__).resolve().parents[3]
CAMERA = "camera: {width: 48, height: 27, fl_x: 20.1, fl_y: 20.1, cx: 24.0, cy: 13.5}\n"


def load(tmp_path, text):
    path = tmp_path / "car.yaml"
    path.write_text(text)
    return load_car(path)


def test_f1tenth_is_the_default_car():
    car = load_car(ROOT / "configs/cars/f1tenth.yaml")
    assert car.actuation == Actuation()
    assert (car.camera.width, car.camera.height, car.camera.pitch) == (672, 376, -6.0)


def test_mini_city_is_the_simulated_car():
    car = load_car(ROOT / "configs/cars/mini_city.yaml")
    assert car.actuation.wheelbase == CarConfig().wheelbase
    assert car.actuation.steering_limit == CarConfig().steering_limit
    # 100 degrees across 48 pixels: 24 / tan(50 degrees)
    assert car.camera.fl_x == car.camera.fl_y == pytest.approx(24 / math.tan(math.radians(50)), rel=1e-15)
    assert (car.camera.cx, car.camera.cy, car.camera.k1, car.camera.pitch) == (24.0, 13.5, 0.0, -6.0)


def test_what_need_not_be_said_of_the_actuation_is_f1tenth(tmp_path):
    own = "speed_to_erpm_gain: 4614, servo_gain: -1.2135, servo_offset: 0.5304, steering_limit: 0.263"
    car = load(tmp_path, CAMERA + f"actuation: {{{own}, wheelbase: 0.3}}")
    assert car.actuation == Actuation(wheelbase=0.3) and car.camera.k1 == 0


@pytest.mark.parametrize(
    ("text", "lacking"),
    [
        ("", "speed_to_erpm_gain, servo_gain, servo_offset, steering_limit, wheelbase"),
        ("actuation: {speed_to_erpm_gain: 4614, servo_offset: 0.53, wheelbase: 0.3}", "servo_gain, steering_limit"),
    ],
)
def test_what_every_car_has_of_its_own_must_be_said(text, lacking, tmp_path):
    with pytest.raises(UserError, match=rf"car\.yaml: actuation lacks {lacking}; measure them"):
        load(tmp_path, CAMERA + text)


@pytest.mark.parametrize(
    "text, sentence",
    [
        (CAMERA + "actuation: {steering_limit: 15}", r"actuation\.steering_limit is 15\.0; give radians"),
        (CAMERA + "actuation: {steering_limit: -0.2}", r"actuation\.steering_limit is -0\.2; give radians above 0"),
        (CAMERA + "actuation: {servo_gain: -0.021}", r"actuation\.servo_gain is -0\.021; .* per radian"),
        (
            CAMERA + "actuation: {steering_limt: 0.2}",
            r"'actuation\.steering_limt'; did you mean 'actuation\.steering_limit'",
        ),
        (CAMERA + "brakes: {}", r"unknown key 'brakes'"),
        ("actuation: {}", r"needs a value for camera\.width, .*camera\.cy; write it into the file$"),
        ("camera: {width: 48}", r"needs a value for camera\.height, "),
        ("camera: 48", r"camera = 48 must be a group"),
        (CAMERA.replace("width: 48", "width: 48.5"), r"camera\.width = 48\.5 is not valid; expected int"),
        (CAMERA.replace("width: 48", "width: 4"), r"camera\.width is 4; give the pixels"),
        (CAMERA.replace("fl_x: 20.1", "fl_x: 2.1"), r"camera\.fl_x is 2\.1; .*not in millimetres"),
        (CAMERA.replace("fl_y: 20.1", "fl_y: -20.1"), r"camera\.fl_y is -20\.1; give the focal length"),
        (CAMERA.replace("fl_y: 20.1", "fl_y: 60.1"), r"camera\.fl_x is 20\.1 and fl_y 60\.1; give two numbers"),
        (CAMERA.replace("cx: 24.0", "cx: 240"), r"camera\.cx is 240\.0; .* half of width"),
        (CAMERA.replace("cy: 13.5", "cy: .inf"), r"camera\.cy is inf; "),
        (CAMERA.replace("cy: 13.5", "cy: .nan"), r"camera\.cy = nan is not a number"),
        (CAMERA.replace("cy: 13.5", "cy: 13.5, k2: -40"), r"camera\.k2 is -40\.0; .*OPENCV lens"),
        (CAMERA.replace("cy: 13.5", "cy: 13.5, pitch: 96"), r"camera\.pitch is 96\.0; give degrees above the horizon"),
    ],
)
def test_mistakes_are_named_with_file_and_key(tmp_path, text, sentence):
    with pytest.raises(
        UserError, match=r"car\.yaml: (unknown key )?" + sentence.removeprefix("unknown key ")
    ) as caught:
        load(tmp_path, text)
    assert str(caught.value).count("car.yaml") == 1 and "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(UserError, match=r"car\.yaml: no such car file; start from configs/cars/f1tenth\.yaml"):
        load_car(tmp_path / "car.yaml")


@pytest.mark.parametrize("key", ["fl_x", "cx", "k1", "p2", "pitch"])
def test_no_number_passes_as_one(key):
    numbers = {"width": 48, "height": 27, "fl_x": 20.0, "fl_y": 20.0, "cx": 24.0, "cy": 13.5}
    with pytest.raises(UserError, match=f"{key} is nan"):
        CameraCalibration(**{**numbers, key: math.nan})


def test_it_is_read_without_torch():
    code = "import sys, aerial2ground.bridge.car_file; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
