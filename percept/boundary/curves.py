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
    count = max(_FEWEST, int(np.ceil(_PER_DECADE * np.log10(upper / lower))) + 1)
    beside = np.multiply.outer(np.asarray(resonances, dtype=float), _BESIDE).ravel()
    beside = beside[(beside > lower) & (beside < upper)]
    omega = _add_apart(np.geomspace(lower, upper, count), beside)
    references, limits = curves(omega)
    # At a pole curves are infinite, and no line leads there.
    finite = np.isfinite(references).all(axis=0) & np.isfinite(limits).all(axis=(0, 1))
    omega = omega[finite]
    references = references[:, finite]
    limits = limits[..., finite]
    x = np.log(omega)
    rows = _log(np.concatenate([references, limits.reshape(-1, omega.size)]))
    width = _log(limits[:, 1]) - _log(limits[:, 0])
    gaps = [width]
    for row in references:
        for side in (0, 1):
            gaps.append(_log(row) - _log(limits[:, side]))
    places = np.concatenate([_turns(x, rows), _crossings(x, np.concatenate(gaps))])
    return _add_apart(omega, np.exp(places))


def _turns(x: Array, rows: Array) -> Array:
    """Return where parabolas through three neighbours of rows (C, M) turn, about where curves do."""
    step = np.diff(x)
    change = np.diff(rows, axis=1)
    curve, left = np.nonzero(change[:, :-1] * change[:, 1:] < 0.0)
    before = step[left]
    after = step[left + 1]
    fall = change[curve, left] / before
    rise = change[curve, left + 1] / after
    middle = 0.5 * (x[left] + x[left + 1])
    return np.asarray(middle + fall / (fall - rise) * 0.5 * (before + after))


def _crossings(x: Array, gaps: Array) -> Array:
    """Return where straight lines between neighbours of gaps (C, M) cross zero."""
    signs = np.sign(gaps)
    curve, left = np.nonzero(signs[:, :-1] * signs[:, 1:] < 0)
    first = gaps[curve, left]
    second = gaps[curve, left + 1]
    return np.asarray(x[left] + first / (first - second) * (x[left + 1] - x[left]))


def _add_apart(omega: Array, more: Array) -> Array:
    """Add frequencies that lie apart from one another and from those there are."""
    for new in np.unique(more):
        index = np.searchsorted(omega, new)
        neighbours = omega[max(index - 1, 0) : index + 1]
        if np.abs(np.log(neighbours / new)).min() > _APART:
            omega = np.insert(omega, index, new)
    return omega


def _log(values: Array) -> Array:
    """Return logarithms; zero and infinity go to the ends of what doubles hold."""
    return np.asarray(np.log(np.clip(values, _TINY, _HUGE)))
