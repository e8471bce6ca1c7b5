"""The posterior of a device by emcee, under the same gate as a study's."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError
from percept.identify.fit import DeviceFit, Whitened
from percept.inference.sampling.gate import Estimates, Run, Settings
from percept.inference.sampling.run import sample

__all__ = ["DevicePosterior", "sample_device"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class DevicePosterior:
    """Moments and limits of log parameters, from draws that passed the gate."""

    mean: Array  # (d,)
    covariance: Array  # (d, d)
    draws: Array  # (S, d) Thinned to the effective size
    run: Run

    def interval(self, level: float) -> tuple[Array, Array]:
        """Return equal-tailed limits of the parameters, each of shape (d,)."""
        tail = 0.5 * (1.0 - level)
        tails = [tail, 1.0 - tail]
        log_limits = np.quantile(self.draws, tails, axis=0)
        lower, upper = np.exp(log_limits)
        return lower, upper


class _Moments:
    """Means and SDs of log parameters, as the sampler estimates them."""

    def __init__(self, whitened: Whitened) -> None:
        self._whitened = whitened

    def components(self, points: Array) -> Array:
        """Log parameters of points (W, d)."""
        return self._whitened.points(points)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Yield means, then SDs, with their influence functions."""
        mean_names = [f"log {name}" for name in self._whitened.names]
        sd_names = [f"SD of {name}" for name in mean_names]
        mean = components.mean(axis=0)
        # What a draw adds to a mean: its distance from it.
        deviation = components - mean
        sd = deviation.std(axis=0)
        yield Estimates(tuple(mean_names), mean, sd), deviation
        # And to an SD, by the slope of the root of the variance.
        influence = (deviation**2 - sd**2) / (2.0 * sd)
        yield Estimates(tuple(sd_names), sd, sd), influence


def sample_device(fit: DeviceFit, *, tolerance: float = 0.02, seed: int = 1) -> DevicePosterior:
    """Sample the posterior of a fitted device.

    Parameters
    ----------
    fit : DeviceFit
        The mode and its covariance, which the sampler starts from.
    tolerance : float
        Monte Carlo error of means and SDs of log parameters, in SDs.
    seed : int
        Of the run.

    Returns
    -------
    DevicePosterior
        Mean and covariance are of all draws that the run keeps.

    Raises
    ------
    RefusalError
        A run that did not mix, with the gate's reasons.
    """
    whitened = Whitened(fit.density, fit.point, fit.covariance)
    settings = Settings(tolerance=tolerance, seed=seed)
    run = sample(whitened, _Moments(whitened), settings)
    if not run.gate.passed:
        reasons = " ".join(run.gate.reasons)
        raise RefusalError(f"The posterior of the device is withheld: {reasons}")
    size = len(whitened.names)
    log_parameters = run.components.reshape(-1, size)
    independent = run.independent().reshape(-1, size)
    return DevicePosterior(
        mean=log_parameters.mean(axis=0),
        covariance=np.cov(log_parameters.T),
        draws=whitened.points(independent),
        run=run,
    )
