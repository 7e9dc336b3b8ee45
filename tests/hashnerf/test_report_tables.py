import math

import pytest

from hashnerf.report_tables import number


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.973, "%", "97.3 %"),
        (0.1, "points", "10.0 points"),
        (-0.006, "points", "−0.6 points"),
        (720.0, "min", "12.0 min"),
        (28.04, "dB", "28.0 dB"),
        (0.0214, "m", "0.021 m"),
        (1.5, "deg", "1.50 deg"),
        (3, "", "3"),
        (3.0, "", "3"),
        (0.0214, "", "0.021"),
        (None, "dB", "–"),
        (math.inf, "dB", "not finite"),
        (math.nan, "", "not finite"),
    ],
)
def test_numbers_are_written_for_people(value, unit, text):
    assert number(value, unit) == text
