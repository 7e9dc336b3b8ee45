"""What a run must reach, preset by preset, and whether it did.

A *key* is a dotted path into the nested results of a run (`plan.risk.n10.hazard_success`). Shares are in [0, 1], PSNR
in dB, time in seconds or milliseconds as the key says. `not_run` maps a key, or the parent of several keys, to the
reason why there is no value.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

# Differences of shares carry rounding of about 1e-17; a limit met to nine digits is met.
SLACK = 1e-9
WHOLE_RUN = "whole run"  # what `seconds_total` must cover to be judged


@dataclass(frozen=True)
class Target:
    """One line of the summary: a figure, and the limit it has to keep in the two presets that are judged."""

    key: str
    label: str
    comparison: str
    """`>=`, `<=` or `==`."""
    unit: str
    """How values are shown: `%`, `points` (of per cent), `dB`, `min` (stored in seconds), `ms`, `m`, `deg` or empty."""
    fast: float | None
    balanced: float | None
    paper: str = ""
    """What the paper reports for the same figure, for orientation."""


@dataclass(frozen=True)
class Verdict:
    """A target beside what was measured."""

    target: Target
    limit: float | None
    """None where the preset is not judged on this figure."""
    measured: float | int | None
    met: bool | None
    """None where there is no limit or the figure was not run."""
    reason: str
    """Why the figure was not run or has no limit here; empty otherwise."""


Exemption = Callable[[Target, float | None], str | None]
"""Told a target that was measured and its limit: why it is not judged (possibly in no words), None if it is."""


def lookup(results: Mapping, key: str) -> Any:
    """The value at a dotted key, None if any part of the path is missing."""
    value: Any = results
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return None
        value = value[part]
    return value


def reason_for(key: str, not_run: Mapping[str, str]) -> str:
    """Why `key` was not run: its own entry or that of a parent (`closed_loop` covers `closed_loop.risk.collisions`)."""
    parts = key.split(".")
    for end in range(len(parts), 0, -1):
        prefix = ".".join(parts[:end])
        if prefix in not_run:
            return not_run[prefix]
    return ""


def limit_of(target: Target, preset: str) -> float | None:
    """The limit of a preset; None where it is not judged."""
    return {"fast": target.fast, "balanced": target.balanced}.get(preset)


def judge(
    targets: Sequence[Target],
    results: Mapping,
    preset: str,
    not_run: Mapping[str, str],
    exempt: Exemption = lambda target, limit: None,
) -> list[Verdict]:
    """Every target beside its measurement; presets other than `fast` and `balanced` are reported without limits."""
    verdicts = []
    for target in targets:
        limit, measured = limit_of(target, preset), lookup(results, target.key)
        if measured is None:
            verdicts.append(Verdict(target, limit, None, None, reason_for(target.key, not_run) or "no value"))
            continue
        why = exempt(target, limit)
        if why is not None:
            verdicts.append(Verdict(target, None, measured, None, why))
            continue
        met = None if limit is None else _keeps(measured, target.comparison, limit)
        verdicts.append(Verdict(target, limit, measured, met, ""))
    return verdicts


def _keeps(measured: float | int, comparison: str, limit: float) -> bool:
    if not math.isfinite(measured):
        return False
    distance = {">=": measured - limit, "<=": limit - measured, "==": -abs(measured - limit)}[comparison]
    return distance >= -SLACK
