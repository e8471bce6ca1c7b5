"""Where an axis has its ticks, and what stands beside them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["Ticks", "linear_ticks", "log_ticks", "minor_ticks"]

#: Places and labels.
Ticks = tuple[list[float], list[str]]

_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
# Digits before which a linear axis says 1e+06.
_LONG = 1e6
# Relative slack within which a place counts as inside the limits.
_SLACK = 1e-9


def linear_ticks(low: float, high: float, *, most: int) -> Ticks:
    """Choose round numbers between the limits of a linear axis.

    Parameters
    ----------
    low, high : float
        Limits, low < high.
    most : int
        Largest number of steps between ticks.

    Returns
    -------
    Ticks
        Multiples of 1, 2, 2.5 or 5 times a power of ten, all with as many decimals as the step has.
    """
    rough = (high - low) / max(1, most)
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(times * power for times in _STEPS if times * power >= rough * (1 - _SLACK))
    slack = _SLACK * (high - low)
    numbers = np.arange(np.ceil((low - slack) / step), np.floor((high + slack) / step) + 1)
    # Adding zero makes a positive zero of a negative one.
    places = (numbers * step + 0.0).tolist()
    if max(abs(low), abs(high)) >= _LONG or step < 1 / _LONG:
        return places, [f"{place:.6g}" for place in places]
    decimals = next(d for d in range(12) if abs(round(step, d) - step) <= _SLACK * step)
    return places, [f"{place:.{decimals}f}" for place in places]


def log_ticks(low: float, high: float, *, most: int, label: Callable[[float], str] | None = None) -> Ticks:
    """Choose powers of ten on a logarithmic axis; 1, 2 and 5 times them where those are few.

    Parameters
    ----------
    low, high : float
        Limits, 0 < low < high.
    most : int
        Largest number of ticks.
    label : callable, optional
        Place to label; powers of ten with their exponent raised by default.

    Returns
    -------
    Ticks
    """
    first, last = np.ceil(np.log10(low) - _SLACK), np.floor(np.log10(high) + _SLACK)
    powers = np.arange(first, last + 1)
    if powers.size < 2:
        places = [
            times * 10.0**power
            for power in np.arange(first - 1, last + 1)
            for times in (1.0, 2.0, 5.0)
            if low * (1 - _SLACK) <= times * 10.0**power <= high * (1 + _SLACK)
        ]
        if len(places) < 2:
            return linear_ticks(low, high, most=most)
        return places, [f"{place:g}" for place in places]
    powers = powers[:: -(-powers.size // most)]
    places = (10.0**powers).tolist()
    if label is not None:
        return places, [label(place) for place in places]
    return places, [f"10$^{{{int(power)}}}$" for power in powers]


def minor_ticks(low: float, high: float, major: list[float]) -> list[float]:
    """Return 2 to 9 times the powers of ten between the limits, where every power of ten is a tick.

    Parameters
    ----------
    low, high : float
        Limits, 0 < low < high.
    major : list of float
        Ticks as `log_ticks` gives them.

    Returns
    -------
    list of float
        Empty where ticks are further or nearer than a decade apart.
    """
    if len(major) < 2 or abs(np.log10(major[1] / major[0]) - 1.0) > _SLACK:
        return []
    powers = np.arange(np.floor(np.log10(low)), np.floor(np.log10(high)) + 1)
    places = (10.0 ** powers[:, None] * np.arange(2.0, 10.0)).ravel()
    return [float(place) for place in places if low <= place <= high]
