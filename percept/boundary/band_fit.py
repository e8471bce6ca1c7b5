"""Three laws of a band against impedance, fitted on the log scale to many sets of bands at once.

Weber: w|Z|. Offset: c + w|Z|, c ≥ 0. Power: w|Z|^p. Each is a model of its own: all of c, w and p at once
cannot be told apart by a few environments.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError

Array = NDArray[np.float64]

#: Parameters of each law, in order.
LAWS: dict[str, tuple[str, ...]] = {"weber": ("w",), "offset": ("c", "w"), "power": ("w", "p")}
_GRID = 61
# Halving alone settles the widest bracket in thirty-odd steps; Newton's take about six.
_STEPS = 60
# After a step as short as this Newton's next would be lost in rounding.
_SETTLED = 1e-9


def fit_law(law: str, impedance: Array, bands: Array) -> Array:
    """Fit a law by least squares on the logarithms."""
    if law not in LAWS:
        raise UsageError(f"law must be one of {', '.join(LAWS)}.", value=law)
    if bands.ndim != 2 or impedance.shape != bands.shape[1:]:
        raise UsageError("bands need one value per environment.", value=(impedance.shape, bands.shape))
    if not ((impedance > 0).all() and (bands > 0).all()):
        raise UsageError("impedances and bands must be positive.")
    if impedance.size < len(LAWS[law]) or (law != "weber" and np.ptp(impedance) == 0):
        raise RefusalError(
            f"{impedance.size} environment(s) cannot determine {' and '.join(LAWS[law])}.",
            hint="Add reference environments of other impedance.",
        )
    y = np.log(bands)
    if law == "weber":
        return np.exp((y - np.log(impedance)).mean(axis=1))[:, None]
    if law == "power":
        x = np.log(impedance)
        centred = x - x.mean()
        exponent = y @ centred / (centred @ centred)
        return np.stack([np.exp(y.mean(axis=1) - exponent * x.mean()), exponent], axis=1)
    return _fit_offset(impedance, y)


def law_band(law: str, parameters: Array, impedance: Array) -> Array:
    """Bands of fitted laws, shape (S, J)."""
    named = dict(zip(LAWS[law], parameters.T[..., None], strict=True))
    return named.get("c", 0.0) + named["w"] * impedance ** named.get("p", 1.0)


def leave_one_out(law: str, impedance: Array, bands: Array) -> tuple[Array, Array]:
    """Predict each environment's band from the others."""
    errors, fits = [], []
    for j in range(impedance.size):
        kept = np.arange(impedance.size) != j
        fitted = fit_law(law, impedance[kept], bands[:, kept])
        errors.append(np.log(law_band(law, fitted, impedance[[j]])[:, 0] / bands[:, j]))
        fits.append(fitted)
    return np.stack(errors, axis=1), np.stack(fits)


def _fit_offset(impedance: Array, y: Array) -> Array:
    """Minimise over the ratio c/w: given it, log w is a mean, so one search for all sets at once."""
    # From e^16 on, c + w|Z| is constant to the digits a band has.
    low, high = np.log(impedance.min()) - 12.0, np.log(impedance.max()) + 16.0
    grid = np.concatenate([[-np.inf], np.linspace(low, high, _GRID)])
    # The grid is the same for all sets: of the squared distances only the product with it differs. The
    # digits this loses could at most choose a neighbouring step, which the brackets hold as well.
    curves = np.log(np.exp(grid)[:, None] + impedance)
    curves -= curves.mean(axis=1, keepdims=True)
    best = (np.einsum("gj,gj->g", curves, curves) - 2.0 * y @ curves.T).argmin(axis=1)
    step = (high - low) / (_GRID - 1)
    centre = np.where(np.isfinite(grid[best]), grid[best], low)
    found = _stationary(centre - step, centre + step, impedance, y)
    # No offset at all may fit best: the search runs in the logarithm, which never gets there.
    none = _cost(np.full(len(y), -np.inf), impedance, y) <= _cost(found, impedance, y)
    ratio = np.where(none, 0.0, np.exp(found))
    w = np.exp((y - np.log(ratio[:, None] + impedance)).mean(axis=1))
    return np.stack([ratio * w, w], axis=1)


def _stationary(left: Array, right: Array, impedance: Array, y: Array) -> Array:
    """Find where the cost turns from falling to rising: Newton's steps, halving the bracket where they fail.

    The cost itself is flat at its minimum, and would give half the digits. Where it rises all the way, or
    falls, the end that is lower.
    """
    rises, falls = _slope(left, impedance, y)[0] >= 0, _slope(right, impedance, y)[0] <= 0
    found = np.where(rises, left, np.where(falls, right, 0.5 * (left + right)))
    active = np.flatnonzero(~rises & ~falls)
    for _ in range(_STEPS):
        at = found[active]
        slope, bend = _slope(at, impedance, y[active])
        right[active] = np.where(slope > 0, at, right[active])
        left[active] = np.where(slope > 0, left[active], at)
        new = at - np.divide(slope, bend, out=np.full_like(at, np.inf), where=bend > 0)
        inside = (new >= left[active]) & (new <= right[active])
        found[active] = np.where(inside, new, 0.5 * (left[active] + right[active]))
        active = active[np.abs(found[active] - at) > _SETTLED]
        if not active.size:
            break
    return found


def _slope(log_ratio: Array, impedance: Array, y: Array) -> tuple[Array, Array]:
    """Half the first and second derivative of the summed squares by the logarithm of c/w."""
    offset = np.exp(log_ratio)[:, None]
    off = _centred(y - np.log(offset + impedance))
    share = offset / (offset + impedance)
    pull = np.einsum("sj,sj->s", off, share)
    spread = _centred(share)
    bend = np.einsum("sj,sj->s", spread, spread) - pull + np.einsum("sj,sj->s", off, share**2)
    return -pull, bend


def _cost(log_ratio: Array, impedance: Array, y: Array) -> Array:
    off = _centred(y - np.log(np.exp(log_ratio)[:, None] + impedance))
    return np.einsum("sj,sj->s", off, off) / off.shape[1]


def _centred(values: Array) -> Array:
    return values - (values.sum(axis=1) / values.shape[1])[:, None]
