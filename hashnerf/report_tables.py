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


def number(value: float | int | None, unit: str = "", digits: int | None = None) -> str:
    """A number with its unit; `%` and `points` are stored as shares, `min` as seconds."""
    if value is None:
        return DASH
    if not math.isfinite(value):
        return "not finite"
    scale = {"%": 100.0, "points": 100.0, "min": 1 / 60}.get(unit, 1.0)
    if digits is None:
        digits = DIGITS.get(unit, 1) if unit else 0 if float(value).is_integer() else 3
    return f"{value * scale:.{digits}f} {unit}".strip().replace("-", "−")
