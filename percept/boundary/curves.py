"""The frequencies that curves over omega are drawn at."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

__all__ = ["drawing_grid"]

# Frequencies per decade: a line through them shows no corners on a page.
_PER_DECADE = 40
# A parabola needs three.
_FEWEST = 3
# Beside a resonance curves bend within a few per cent of its omega.
_BESIDE = 1.0 + np.array([-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04])
# Frequencies nearer one another than this fraction show nothing more.
_APART = 2e-3
_TINY = np.finfo(np.float64).tiny
_HUGE = np.finfo(np.float64).max


def drawing_grid(
    curves: Callable[[Array], tuple[Array, Array]], lower: float, upper: float, resonances: Array
) -> Array:
    """Choose frequencies to draw curves at: even in log omega, and where the curves turn or cross.

    No verdict rests on the grid.

    Parameters
    ----------
    curves : callable
        From frequencies (M,), rad/s, to curves of the references (C, M) and limits (B, 2, M).
    lower, upper : float
        First and last frequency, rad/s.
    resonances : ndarray, shape (R,)
        Frequencies near which curves bend most, rad/s.

    Returns
    -------
    ndarray, shape (N,)
        rad/s, increasing.
    """
    decades = np.log10(upper / lower)
    intervals = int(np.ceil(_PER_DECADE * decades))
    count = max(_FEWEST, intervals + 1)
    even = np.geomspace(lower, upper, count)
    beside = np.multiply.outer(resonances, _BESIDE)
    beside = beside[(beside > lower) & (beside < upper)]
    omega = _add_apart(even, beside)
    references, limits = curves(omega)
    # At a pole curves are infinite, and no line leads there.
    finite = np.isfinite(references).all(axis=0)
    finite &= np.isfinite(limits).all(axis=(0, 1))
    omega = omega[finite]
    references = references[:, finite]
    limits = limits[..., finite]
    x = np.log(omega)
    log_references = _log(references)
    log_lower = _log(limits[:, 0])
    log_upper = _log(limits[:, 1])
    turns = _turns(x, np.concatenate([log_references, log_lower, log_upper]))
    gaps = [log_upper - log_lower]
    for row in log_references:
        gaps.append(row - log_lower)
        gaps.append(row - log_upper)
    crossings = _crossings(x, np.concatenate(gaps))
    bends = np.concatenate([turns, crossings])
    return _add_apart(omega, np.exp(bends))


def _turns(x: Array, rows: Array) -> Array:
    """Return where parabolas through three neighbours of rows (C, M) turn."""
    step = np.diff(x)
    change = np.diff(rows, axis=1)
    following = change[:, 1:]
    product = change[:, :-1] * following
    curve, left = np.nonzero(product < 0.0)
    before = step[left]
    after = step[left + 1]
    first_slope = change[curve, left] / before
    second_slope = change[curve, left + 1] / after
    # The slopes belong to the middles of both steps, and the parabola's slope is straight between.
    middle = 0.5 * (x[left] + x[left + 1])
    fraction = first_slope / (first_slope - second_slope)
    length = before + after
    distance = fraction * 0.5 * length
    turns = middle + distance
    return np.asarray(turns)


def _crossings(x: Array, gaps: Array) -> Array:
    """Return where straight lines between neighbours of gaps (C, M) cross zero."""
    signs = np.sign(gaps)
    following = signs[:, 1:]
    product = signs[:, :-1] * following
    curve, left = np.nonzero(product < 0)
    first = gaps[curve, left]
    second = gaps[curve, left + 1]
    fraction = first / (first - second)
    start = x[left]
    step = x[left + 1] - start
    places = start + fraction * step
    return np.asarray(places)


def _add_apart(omega: Array, more: Array) -> Array:
    """Add frequencies that differ from each other and from the present ones."""
    for new in np.unique(more):
        index = np.searchsorted(omega, new)
        previous = max(index - 1, 0)
        neighbours = omega[previous : index + 1]
        ratios = neighbours / new
        distances = np.abs(np.log(ratios))
        if distances.min() > _APART:
            omega = np.insert(omega, index, new)
    return omega


def _log(values: Array) -> Array:
    """Return logarithms; zero and infinity go to the ends of what doubles hold."""
    finite = np.clip(values, _TINY, _HUGE)
    return np.asarray(np.log(finite))
