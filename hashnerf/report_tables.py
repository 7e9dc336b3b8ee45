"""Tables of a report: rows of text, formatted for people. A value that is missing becomes a dash."""

import math
from dataclasses import dataclass

DASH = "–"
DIGITS = {"m": 3, "deg": 2}
"""Decimals of units that need other than one."""


@dataclass(frozen=True)
class Table:
    """A formatted table; the first column names the rows."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def text_lines(table: "Table") -> list[str]:
    """Returns the lines of a table for a terminal, columns aligned."""
    widths = [max(map(len, column)) for column in zip(table.header, *table.rows)]
    rows = (table.header, *table.rows)
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]


def number(value: float | int | None, unit: str = "", digits: int | None = None) -> str:
    """A number with its unit; `%` and `points` are stored as shares, `min` as seconds."""
    if value is None:
        return DASH
    if not math.isfinite(value):
        return "not finite"
    scale = {"%": 100.0, "points": 100.0, "min": 1 / 60}.get(unit, 1.0)
    digits = _usual_digits(value, unit) if digits is None else digits
    return f"{value * scale:.{digits}f} {unit}".strip().replace("-", "−")


def number_beside(value: float | int | None, limit: float | int | None, unit: str = "") -> str:
    """The same, with more decimals (6 at most) where it would read like a limit that it is not."""
    if value is None or limit is None or value == limit or not math.isfinite(value):
        return number(value, unit)
    usual = _usual_digits(value, unit)
    apart = (d for d in range(usual, 7) if number(value, unit, d) != number(limit, unit, d))
    return number(value, unit, next(apart, usual))


def _usual_digits(value: float | int, unit: str) -> int:
    return DIGITS.get(unit, 1) if unit else 0 if float(value).is_integer() else 3
