import math

import pytest

from hashnerf.report_tables import Table, number, number_beside, text_lines


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


@pytest.mark.parametrize(
    ("value", "limit", "unit", "text"),
    [
        (0.00024, 0.0, "m", "0.0002 m"),
        (3.0396, 3.0, "deg", "3.04 deg"),
        (3.0004, 3.0, "deg", "3.0004 deg"),
        (0.0, 0.0, "m", "0.000 m"),
        (1e-12, 0.0, "m", "0.000 m"),
        (0.1204, 0.12, "m", "0.1204 m"),
        (None, 0.0, "m", "–"),
        (0.5, None, "%", "50.0 %"),
        (math.nan, 0.0, "m", "not finite"),
    ],
)
def test_what_missed_its_limit_by_little_does_not_read_like_it(value, limit, unit, text):
    assert number_beside(value, limit, unit) == text


def test_a_table_for_a_terminal_has_aligned_columns():
    assert text_lines(Table(("a", "long name"), (("1.5 m", "x"), ("2", "y")))) == [
        "a      long name",
        "1.5 m  x",
        "2      y",
    ]
