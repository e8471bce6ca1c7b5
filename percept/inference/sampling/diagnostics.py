"""Convergence measures: autocorrelation time, Monte Carlo error and rank R-hat across ensembles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import fft, special

Array = NDArray[np.float64]
_WINDOW = 5.0  # Sokal's window, in autocorrelation times
#: More values of a quantity than these, or fewer walkers per ensemble, are not needed to see how
#: long it remembers.
_MOST_VALUES, _FEWEST_WALKERS = 1 << 15, 8
_BATCHES = (4, 20)  # fewest and most batches per ensemble


def autocorrelation_time(series: Array) -> Array:
    """Integrate the autocorrelation function, averaged over ensembles and walkers.

    The autocorrelation functions of all walkers are averaged before they are summed over Sokal's
    window, so that runs of ten autocorrelation times are enough with 64 walkers or more.
    """
    _, length, _, count = series.shape
    # One mean and scale for all walkers: a walker that is stuck elsewhere must show.
    centred = series - series.mean(axis=(0, 1, 2))
    padded = fft.next_fast_len(2 * length, real=True)
    power = np.zeros((padded // 2 + 1, count))
    for ensemble in centred:
        spectrum = fft.rfft(ensemble, n=padded, axis=0)
        power += (spectrum.real**2 + spectrum.imag**2).sum(axis=1)
    covariance = fft.irfft(power, n=padded, axis=0)[:length]
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = covariance / covariance[0]
    times = 2.0 * np.cumsum(rho, axis=0) - 1.0
    window = np.arange(length)[:, None] >= _WINDOW * times
    first = np.where(window.any(axis=0), window.argmax(axis=0), length - 1)
    chosen = times[first, np.arange(count)]
    return np.where(np.isfinite(chosen), np.maximum(chosen, 1.0), np.inf)


def monte_carlo_error(influence: Array, times: Array) -> Array:
    """Estimate the standard error of the estimates from their influence functions."""
    ensembles, length, walkers, count = influence.shape
    longest = float(np.max(times, initial=1.0))
    batches = (
        int(np.clip(length / (3.0 * longest), *_BATCHES)) if np.isfinite(longest) else _BATCHES[0]
    )
    size = length // batches
    averages = (
        influence.mean(axis=2)[:, : size * batches]
        .reshape(ensembles, batches, size, count)
        .mean(axis=2)
    )
    by_batches = np.sqrt(averages.reshape(-1, count).var(axis=0, ddof=1) / (ensembles * batches))
    draws = ensembles * length * walkers
    by_time = np.sqrt(
        np.einsum("etwq,etwq->q", influence, influence) / draws * np.minimum(times, draws) / draws
    )
    return np.maximum(by_batches, by_time)


def rank_rhat(chains: Array) -> Array:
    """Rank-normalised split R-hat, the larger of bulk and folded (Vehtari et al. 2021)."""
    folded = np.abs(chains - np.median(chains, axis=(0, 1)))
    return np.maximum(split_rhat(normal_scores(chains)), split_rhat(normal_scores(folded)))


def split_rhat(chains: Array) -> Array:
    """R-hat of the halves of chains (M, N, V); one of what does not vary."""
    length = chains.shape[1] // 2
    split = np.concatenate([chains[:, :length], chains[:, chains.shape[1] - length :]])
    within = split.var(axis=1, ddof=1).mean(axis=0)
    between = split.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.sqrt((length - 1) / length + between / within)
    return np.where(np.ptp(split, axis=(0, 1)) == 0, 1.0, found)


def normal_scores(values: Array) -> Array:
    """Replace values by the normal scores of their ranks."""
    # A copy whatever the layout: of columns that lie together `ascontiguousarray` would give the
    # values.
    columns = np.array(values.reshape(-1, values.shape[-1]).T, order="C")
    size = columns.shape[1]
    # Of all ranks there may be, with the half ranks of two tied values.
    scores = special.ndtri((np.arange(1.0, size + 0.5, 0.5) - 0.375) / (size + 0.25))
    for column in columns:
        order = np.argsort(column)
        ascending = column[order]
        # Walkers that stay repeat their values: ties, which share the mean of their ranks.
        first = np.flatnonzero(np.concatenate([[True], ascending[1:] != ascending[:-1]]))
        count = np.diff(first, append=size)
        column[order] = np.repeat(scores[2 * first + count - 1], count)
    return np.ascontiguousarray(columns.T).reshape(values.shape)


def some_walkers(series: Array, most: int = _MOST_VALUES) -> Array:
    """Thin walkers evenly, for what takes long and needs only `most` values of a quantity."""
    ensembles, length, walkers, _ = series.shape
    kept = max(_FEWEST_WALKERS, most // (ensembles * length))
    return series[:, :, :: math.ceil(walkers / kept)]
