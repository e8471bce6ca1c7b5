"""Interval limits from raw draws, as users of a general sampler work them out, and their errors."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]
KINDS = ("mean", "user", "share")
LEVEL, SHARE, CONFIDENCE = 0.99, 0.99, 0.95
_ITERATIONS = 30


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Limits on the response scale."""

    value: Array  # (3, 2, C) Kinds, lower and upper, cells (parameter-major)
    error: Array  # (3, 2, C) Monte Carlo standard errors
    effective: float  # Effective draws of the slowest quantity behind them


def share_half_widths(off: Array, spread: Array, share: float = SHARE) -> Array:
    """Half-width h with Phi((h - off)/spread) - Phi((-h - off)/spread) = share."""
    apart = np.abs(off) / spread
    t = np.maximum(apart + special.ndtri(share), special.ndtri(0.5 * (1.0 + share)))
    for _ in range(_ITERATIONS):
        missing = special.ndtr(apart - t) + special.ndtr(-apart - t) - (1.0 - share)
        rate = np.exp(-0.5 * (t - apart) ** 2) + np.exp(-0.5 * (t + apart) ** 2)
        step = missing * np.sqrt(2.0 * np.pi) / rate
        t = t + step
        if np.all(np.abs(step) <= 1e-14 * t):
            break
    return t * spread


def limits_of_draws(beta: Array, spread: Array, rng: np.random.Generator) -> Limits:
    """Quantiles of draws."""
    from arviz_stats.base.array import BaseArray

    array_stats: Any = BaseArray()
    tails = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
    user = beta + spread * rng.standard_normal(beta.shape)
    centre = beta.mean(axis=(0, 1))
    half = share_half_widths(beta - centre, spread)
    h = np.quantile(half, CONFIDENCE, axis=(0, 1))
    quantiles = [np.quantile(draws, tails, axis=(0, 1)) for draws in (beta, user)]
    value = np.stack([*quantiles, np.stack([centre - h, centre + h])])

    def chains(draws: Array) -> Array:
        return np.moveaxis(draws, -1, 0)

    def quantile_error(draws: Array, prob: float) -> Array:
        return np.asarray(array_stats.mcse(chains(draws), method="quantile", prob=prob))

    errors = [[quantile_error(draws, tail) for tail in tails] for draws in (beta, user)]
    of_share = np.hypot(
        quantile_error(half, CONFIDENCE), np.asarray(array_stats.mcse(chains(beta), method="mean"))
    )
    # 5 and 95 %: the tails whose draws are counted since Vehtari et al. (2021).
    effective = [
        np.asarray(array_stats.ess(chains(draws), method=method, **how))
        for draws in (beta, np.log(spread))
        for method, how in (("bulk", {}), ("tail", {"prob": (0.05, 0.95)}))
    ]
    return Limits(value, np.stack([*errors, [of_share, of_share]]), float(np.nanmin(effective)))
