"""Frozen numbers against today's."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["differences"]

#: Rounding, relative to the largest number of a list.
EXACT = 1e-12
#: A quantile of draws lies between two of them: rounding may choose the next. Where a departure is
#: largest it is flat, and the frequency keeps half of the digits.
POINTWISE = 1e-6
#: Standard errors between two runs.
FAR = 3.0
#: Parts of report.json that come from a search or from draws with the scene's seed: another order
#: of the same work keeps half of the digits.
SEARCHED = ("verdicts", "design", "sensitivity", "band", "zwidth")


def differences(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Name every number that left its tolerance, and every number that is gone or new."""
    return [
        *_exact(frozen, now),
        *_curves(frozen, now),
        *_endpoints(frozen, now),
        *_estimates(frozen, now),
    ]


def _pairs(
    part: str, frozen: Mapping[str, Any], now: Mapping[str, Any], lost: list[str]
) -> Iterator[tuple[str, Any, Any]]:
    for name in sorted(frozen[part].keys() ^ now[part].keys()):
        lost.append(f"{name}: {'gone' if name in frozen[part] else 'new'}")
    for name, old in frozen[part].items():
        if name in now[part]:
            yield name, old, now[part][name]


def _exact(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    found: list[str] = []
    for name, old, new in _pairs("exact", frozen, now, found):
        if not _agree(old, new, POINTWISE if name.startswith(SEARCHED) else EXACT):
            found.append(f"{name}: was {old!r}, is {new!r}")
    return found


def _agree(old: Any, new: Any, tolerance: float) -> bool:
    """Compare values of any shape; numbers of an innermost list are held to the largest of them."""
    if isinstance(old, dict) and isinstance(new, dict):
        return old.keys() == new.keys() and all(
            _agree(old[key], new[key], POINTWISE if "omega" in key else tolerance) for key in old
        )
    if isinstance(old, list) and isinstance(new, list):
        scale = max((abs(value) for value in old if _is_number(value)), default=0.0)
        return len(old) == len(new) and all(
            _near(a, b, scale, tolerance)
            if _is_number(a) and _is_number(b)
            else _agree(a, b, tolerance)
            for a, b in zip(old, new, strict=True)
        )
    if _is_number(old) and _is_number(new):
        return _near(old, new, abs(old), tolerance)
    return bool(old == new)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _near(old: float, new: float, scale: float, tolerance: float) -> bool:
    return old == new or abs(new - old) <= tolerance * scale < math.inf


def _curves(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    found: list[str] = []
    for name, old, new in _pairs("curves", frozen, now, found):
        tolerance = POINTWISE if name.startswith("pointwise") else EXACT
        # The lower curve is a distance that may go to zero: both are held to the larger of the two.
        scale = [max(pair) for pair in zip(old["lower"], old["upper"], strict=True)]
        for side in ("lower", "upper"):
            for at, (a, b) in enumerate(zip(old[side], new[side], strict=True)):
                if not _near(a, b, scale[at], tolerance):
                    found.append(f"{name}, {side} at {at}: was {a!r}, is {b!r}")
    return found


def _endpoints(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Compare on the model's scale, where the errors are fractions of the half-width."""
    found: list[str] = []
    for name, old, new in _pairs("endpoints", frozen, now, found):
        scale = math.log if old["log"] else float
        if old["log"] and not 0.0 < new["lower"] < new["upper"]:
            found.append(
                f"{name}: was {old['lower']!r} to {old['upper']!r}, is {new['lower']!r} to"
                f" {new['upper']!r}"
            )
            continue
        half = 0.5 * (scale(old["upper"]) - scale(old["lower"]))
        for at, side in enumerate(("lower", "upper")):
            error = math.hypot(old["error"][at], new["error"][at])
            off = abs(scale(new[side]) - scale(old[side])) / half
            if not off <= FAR * error:
                found.append(
                    f"{name}, {side}: was {old[side]!r}, is {new[side]!r}, {off / error:.1f}"
                    " standard errors"
                )
    return found


def _estimates(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    found: list[str] = []
    for name, old, new in _pairs("estimates", frozen, now, found):
        error = math.hypot(old["error"], new["error"])
        for a, b in zip(old["values"], new["values"], strict=True):
            if not abs(b - a) <= FAR * error:
                found.append(f"{name}: was {a!r}, is {b!r}, with an error of {error:.3g}")
    return found
