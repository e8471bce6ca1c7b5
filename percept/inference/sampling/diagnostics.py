"""Convergence measures: autocorrelation time, Monte Carlo error and R-hat across ensembles.

Series are (E, T, W, Q): ensembles, kept positions, walkers and quantities.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import fft, special

Array = NDArray[np.float64]

#: Sokal's window, in autocorrelation times.
_WINDOW = 5.0


def autocorrelation_time(series: Array) -> Array:
    """Integrate the autocorrelation function, averaged over ensembles and walkers.

    The autocorrelation functions of all walkers are averaged before they are summed over Sokal's
    window, so that many walkers make short runs enough: see `_TIMES_NEEDED` of the gate.

    Parameters
    ----------
    series : ndarray
        Shape (E, T, W, Q).

    Returns
    -------
    ndarray
        Shape (Q,), in positions; at least one, infinite where the quantity never changes.
    """
    _, length, _, count = series.shape
    # One mean and scale for all walkers: a walker that is stuck elsewhere must show.
    centred = series - series.mean(axis=(0, 1, 2))
    padded = fft.next_fast_len(2 * length, real=True)
    power = np.zeros((padded // 2 + 1, count))
    for ensemble in centred:
        spectrum = fft.rfft(ensemble, n=padded, axis=0)
        squares = spectrum.real**2 + spectrum.imag**2
        power += squares.sum(axis=1)
    covariance = fft.irfft(power, n=padded, axis=0)[:length]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / covariance[0]
    times = 2.0 * np.cumsum(correlation, axis=0) - 1.0
    lags = np.arange(length)[:, None]
    enough = lags >= _WINDOW * times
    enough[-1] = True
    window = enough.argmax(axis=0)
    chosen = times[window, np.arange(count)]
    known = np.isfinite(chosen)
    return np.where(known, np.maximum(chosen, 1.0), np.inf)


def monte_carlo_error(influence: Array) -> Array:
    """Estimate the standard error of the estimates from their influence functions.

    Walkers never see one another, so that the scatter of their means tells the error, whatever a
    walker remembers.

    Parameters
    ----------
    influence : ndarray
        Shape (E, T, W, Q).

    Returns
    -------
    ndarray
        Shape (Q,).
    """
    means = influence.mean(axis=1)
    means = means.reshape(-1, means.shape[-1])
    scatter = means.std(axis=0, ddof=1)
    return np.asarray(scatter / math.sqrt(len(means)))


def split_rhat(chains: Array, method: str) -> Array:
    """Return R-hat of the halves of chains (Vehtari et al. 2021).

    ArviZ has the same; importing it takes a fifth of a fit.

    Parameters
    ----------
    chains : ndarray
        Shape (M, N, V): M chains of N draws of V quantities, at least four draws.
    method : str
        ``"rank"``, of ranks and of their distances from the median, or ``"split"``, of the values.

    Returns
    -------
    ndarray
        Shape (V,); one where nothing varies.
    """
    half = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :half], chains[:, -half:]])
    if method == "split":
        return _rhat(halves)
    median = np.median(halves, axis=(0, 1))
    distances = np.abs(halves - median)
    of_places = _rhat(normal_scores(halves))
    of_distances = _rhat(normal_scores(distances))
    return np.maximum(of_places, of_distances)


def _rhat(chains: Array) -> Array:
    """Compare the means of chains (M, N, V) with what varies in them."""
    length = chains.shape[1]
    variances = chains.var(axis=1, ddof=1)
    within = variances.mean(axis=0)
    means = chains.mean(axis=1)
    between = means.var(axis=0, ddof=1)
    # Chains that are constants divide by zero.
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.sqrt(between / within + (length - 1) / length)
    constant = np.ptp(chains, axis=(0, 1)) == 0
    return np.where(constant, 1.0, found)


def normal_scores(values: Array) -> Array:
    """Replace values (..., Q) by the normal scores of their ranks among all of the same quantity.

    Tied values, of walkers that stay, share the mean of their ranks. Ranks are shifted by Blom's
    numbers, with which scores are close to the means of a normal's order statistics.
    """
    columns = values.reshape(-1, values.shape[-1]).T.copy()
    draws = columns.shape[1]
    # Mean ranks are multiples of a half.
    rank = 0.5 * np.arange(2 * draws + 1)
    score_of_twice = special.ndtri((rank - 0.375) / (draws + 0.25))
    for column in columns:
        _, place, count = np.unique(column, return_inverse=True, return_counts=True)
        # Of each distinct value: twice the mean rank of all draws that have it.
        twice_rank = 2 * np.cumsum(count) - count + 1
        column[:] = score_of_twice[twice_rank[place]]
    return columns.T.reshape(values.shape)
