"""Log density of a device given a log, in any affine coordinates of its log parameters.

A line is one frequency of the log. Its force F and velocity V are complex normals with unknown
means and an unknown covariance, which R repeats show. At the best mean velocity and covariance the
likelihood depends on the device through t = √R·(F - Z·V)/√s alone, where s is the scatter of
F - Z·V between repeats. It is the product of (1 + abs(t)²)^-R over lines.

Every line brings a covariance of its own, so the power R claims too much: the slope of the log
likelihood has R/(R - 1) times the variance that its curvature says. The power R - 1 makes both
equal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.identify.model import DeviceModel, Parameter
from percept.identify.spectra import Spectra

__all__ = ["DeviceDensity"]

Array = NDArray[np.float64]

#: Numbers in one array of a batch: 4 MB of complex ones, whatever the length of the log.
_BATCH_NUMBERS = 1 << 18


class DeviceDensity:
    """Log posterior density of log parameters, as `percept.inference.sampling` takes it.

    Parameters
    ----------
    model : DeviceModel
        The device.
    spectra : Spectra
        The log at K lines.
    parameters : sequence of Parameter
        With their priors, in the model's order.
    """

    def __init__(
        self, model: DeviceModel, spectra: Spectra, parameters: Sequence[Parameter]
    ) -> None:
        self.model = model
        self.spectra = spectra
        # One less than R, so that curvature and slope agree on the variance: see the module.
        self._power = spectra.repeats - 1
        self.parameters = tuple(parameters)
        self.names = [parameter.name for parameter in parameters]
        medians = [parameter.median for parameter in parameters]
        sds = [parameter.sd for parameter in parameters]
        self.prior_mean = np.log(medians)
        self.prior_sd = np.array(sds)

    def __call__(self, points: Array) -> Array:
        """Log density of points (W, d), without its constant, (W,)."""
        batch_size = max(1, _BATCH_NUMBERS // self.spectra.omega.size)
        densities = []
        for start in range(0, len(points), batch_size):
            batch = points[start : start + batch_size]
            densities.append(self._of_batch(batch))
        return np.concatenate(densities)

    def _of_batch(self, points: Array) -> Array:
        """Log density of as many points as memory allows."""
        prior_squares = self._prior_residuals(points) ** 2
        # Far out in the tails exp overflows. The density is zero there.
        with np.errstate(over="ignore", invalid="ignore"):
            t = self.standardized(points)
            misfit = np.log1p(np.abs(t) ** 2).sum(axis=1)
        log_likelihood = -self._power * misfit
        density = log_likelihood - 0.5 * prior_squares.sum(axis=1)
        return np.where(np.isfinite(density), density, -np.inf)

    def _prior_residuals(self, points: Array) -> Array:
        """Distances from the prior means, in prior SDs."""
        return (points - self.prior_mean) / self.prior_sd

    def standardized(self, points: Array) -> NDArray[np.complex128]:
        """Return t of every line, (W, K)."""
        spectra = self.spectra
        force, transfer = self.model.force(points, spectra)
        # The scatter of F - Z·V: Σ abs(F)² - 2 Re Σ conj(Z)·F·conj(V) + abs(Z)² Σ abs(V)².
        cross = (transfer.conj() * spectra.cross_scatter).real
        of_velocity = np.abs(transfer) ** 2 * spectra.velocity_scatter
        scatter = spectra.force_scatter - 2.0 * cross
        scatter = scatter + of_velocity
        residual = spectra.force - force
        return residual * np.sqrt(spectra.repeats / scatter)

    def residuals(self, point: Array) -> Array:
        """Return numbers whose squares sum to -2 log density, for a least-squares solver."""
        t = self.standardized(point[None])[0]
        square = np.abs(t) ** 2
        # log(1 + u)/u tends to one at u = 0.
        ratio = np.ones_like(square)
        np.divide(np.log1p(square), square, out=ratio, where=square > 0.0)
        weight = 2.0 * self._power * ratio
        weighted = t * np.sqrt(weight)
        prior = self._prior_residuals(point)
        return np.concatenate([weighted.real, weighted.imag, prior])
