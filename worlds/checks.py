"""Checking config values: one sentence naming key, value and what to do."""

import math

from hashnerf.errors import UserError


def check_between(key: str, value: float | int, low: float | int, high: float | int) -> None:
    """Raises UserError unless `value` is a finite number in [low, high]."""
    if not (math.isfinite(value) and low <= value <= high):
        raise UserError(f"{key} = {value} is out of range; give a number from {low} to {high}.")


def check_one_of(key: str, value: str, choices: tuple[str, ...]) -> None:
    """Raises UserError unless `value` is one of `choices`."""
    if value not in choices:
        raise UserError(f"{key} = {value!r} is not known; give one of {', '.join(choices)}.")
