import numpy as np
import pytest

from aerial2ground.bridge.drive_chart import column, drive_chart
from hashnerf.errors import UserError
from hashnerf.figure_style import png_bytes

HEAD = {"actuation": {}, "guard": {}}


def cycle(time, state, fault=None, **changes):
    known = {"steering": 0.1, "speed": 0.5, "wanted": [0.1, 0.5], "picture_age": 0.02, "erpm": 2307}
    return {"t": time, "state": state, "fault": fault, **known, **changes}


def test_a_drive_is_drawn_with_its_states_and_faults():
    unknown = {"wanted": None, "picture_age": None, "erpm": None}
    records = [HEAD, cycle(5.0, "DISARMED", **unknown), cycle(6.0, "ARMED"), cycle(7.0, "ARMED")]
    records += [cycle(8.0, "STOPPING", "E_STOP"), cycle(9.0, "FAULT", "E_STOP"), cycle(10.0, "READY")]
    figure = drive_chart(records)
    steering, speed, age, states = figure.axes
    measured = next(line for line in speed.lines if line.get_label() == "measured")
    assert measured.get_ydata()[1] == pytest.approx(0.5)  # 2307 / 4614 erpm per m/s
    np.testing.assert_allclose(measured.get_xdata(), range(6))
    assert [text.get_text() for text in speed.texts] == ["E_STOP"] and speed.texts[0].xy[0] == pytest.approx(3)
    assert [text.get_text() for text in states.texts] == ["DISARMED", "ARMED", "STOPPING", "FAULT"]
    assert np.isnan(age.lines[0].get_ydata()[0]) and age.lines[0].get_ydata()[1] == pytest.approx(20)
    assert len(steering.lines) == 2 and png_bytes(figure)[:4] == b"\x89PNG"


def test_what_is_not_known_is_nan():
    np.testing.assert_array_equal(column([{"a": 1}, {"a": None}, {}, {"a": 0}], "a"), [1, np.nan, np.nan, 0])


@pytest.mark.parametrize("records", [[], [HEAD], [HEAD, cycle(1.0, "DISARMED")]])
def test_no_drive_no_chart(records):
    with pytest.raises(UserError, match="holds no drive"):
        drive_chart(records)
