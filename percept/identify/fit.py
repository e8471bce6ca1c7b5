"""The most probable device of a log, its covariance, and the parameters that the log cannot tell.

A log is force and motion of a device, as spectra at K frequencies (lines) with R repeats. The
unknown is a point: the logarithms of d parameters, such as masses and springs. The fit has steps:

1. A device with one mode fewer is fitted first; it is where one of the climbs starts.
2. Least squares climb from several rough devices. The climb of the lowest cost is near the mode of
   the posterior density. J'J there is its curvature but for second derivatives.
3. Coordinates in which J'J is the unit matrix (`Whitened`) suit `find_mode`. It ends at the mode of
   the density itself, and its curvature there gives the covariance.
4. Modes of the device are put in the order of their resonances.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from percept.errors import RefusalError
from percept.identify.density import DeviceDensity
from percept.identify.model import OF_A_MODE, DeviceModel, Parameter, Terms, mode_names
from percept.identify.spectra import Spectra
from percept.identify.starts import rough_devices
from percept.inference.sampling.mode import find_mode

__all__ = ["DeviceFit", "Whitened", "climb", "fit_device"]

Array = NDArray[np.float64]

#: SD of a log parameter above which the log does not tell it: 95 % of its posterior then span a
#: factor of exp(3.92) = 50.
_LARGEST_SD = 1.0
#: Width in SDs of the middle 95 % of a normal distribution: 2 times 1.96.
_WIDTH_OF_95_PERCENT = 3.92
#: Standard errors by which the misfit may exceed 1. The misfit of noise alone has a gamma law, and
#: exceeds it by more in 1 of 1,800 logs of 20 lines, and in fewer of longer logs.
_MOST_ERRORS = 4.0


@dataclasses.dataclass(frozen=True, eq=False)
class DeviceFit:
    """The mode of a posterior with its curvature."""

    density: DeviceDensity
    point: Array  # (d,) Log parameters at the mode
    covariance: Array  # (d, d) Of the log parameters

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return self.density.names

    @property
    def sd(self) -> Array:
        """SDs of the log parameters, (d,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def misfit(self) -> float:
        """Mean deviance of the K lines over what noise alone leaves on average.

        With t the residual of a line in standard errors, log(1 + abs(t)²) has an exponential law of
        mean 1/(R - 1) under noise alone. The misfit then is 1 with a standard error of 1/√K.
        """
        t = self.density.standardized(self.point[None])
        deviances = np.log1p(np.abs(t) ** 2)
        degrees_of_freedom = self.density.spectra.repeats - 1
        return float(degrees_of_freedom * np.mean(deviances))

    @property
    def fits(self) -> bool:
        """Whether the misfit is what noise alone leaves."""
        standard_error = 1.0 / np.sqrt(self.density.spectra.omega.size)
        return self.misfit < 1.0 + _MOST_ERRORS * standard_error

    def unidentified(self) -> dict[str, str]:
        """Return why the log does not tell a parameter, by the name of each such parameter."""
        reasons = {}
        for name, sd in zip(self.names, self.sd, strict=True):
            if sd > _LARGEST_SD:
                factor = np.exp(_WIDTH_OF_95_PERCENT * sd)
                reasons[name] = f"95 % of its posterior span a factor of {factor:.2g}"
        omega = self.density.spectra.omega
        modes = self.density.model.terms.modes
        for mode in range(1, modes + 1):
            resonance = self.resonance(mode)
            if omega[0] <= resonance <= omega[-1]:
                continue
            reason = f"the mode resonates at {resonance:.4g} rad/s, outside the log's band"
            # This tells more than a wide posterior, whose reason it replaces.
            for name in mode_names(mode):
                reasons[name] = reason
        return reasons

    def resonance(self, mode: int) -> float:
        """Return where mass and spring of a mode, counted from 1, resonate, rad/s."""
        mass, stiffness, _ = mode_names(mode)
        log_mass = self.point[self.names.index(mass)]
        log_stiffness = self.point[self.names.index(stiffness)]
        return float(np.exp(0.5 * (log_stiffness - log_mass)))


class Whitened:
    """A density in coordinates z, in which a fit has mean 0 and unit covariance."""

    def __init__(self, density: DeviceDensity, centre: Array, covariance: Array) -> None:
        self._density = density
        self._centre = centre
        self._factor = np.linalg.cholesky(covariance)

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return self._density.names

    def points(self, z: Array) -> Array:
        """Take coordinates z (W, d) to log parameters."""
        return self._centre + z @ self._factor.T

    def covariance(self, covariance_of_z: Array) -> Array:
        """Take a covariance (d, d) of z to that of the log parameters."""
        return self._factor @ covariance_of_z @ self._factor.T

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates z (W, d), shape (W,)."""
        log_parameters = self.points(points)
        return self._density(log_parameters)


def fit_device(
    spectra: Spectra,
    terms: Terms,
    parameters: Sequence[Parameter] | None = None,
) -> DeviceFit:
    """Fit a device to a log.

    Parameters
    ----------
    spectra : Spectra
        The log at K lines.
    terms : Terms
        What the device has.
    parameters : sequence of Parameter, optional
        Parameters with other priors, in the order of `terms.parameters`.

    Returns
    -------
    DeviceFit
        Modes are in the order of their resonances.

    Raises
    ------
    RefusalError
        More parameters than numbers in the log.
    """
    parameters = parameters or terms.parameters
    density = DeviceDensity(DeviceModel(terms), spectra, parameters)
    # A line has two numbers, the real and the imaginary part of its impedance.
    if len(density.names) >= 2 * spectra.omega.size:
        raise RefusalError(
            f"{spectra.omega.size} frequencies do not tell {len(density.names)} parameters.",
            hint="Ask for fewer modes, or give a longer period.",
        )
    fewer = None
    if terms.modes > 1:
        fewer_terms = dataclasses.replace(terms, modes=terms.modes - 1)
        fewer_parameters = parameters[:-OF_A_MODE]
        fewer = fit_device(spectra, fewer_terms, fewer_parameters).point[None]
    # A climb that gave up counts with the others: `find_mode` goes on from where it is.
    climbs = [climb(density, start) for start in rough_devices(density, fewer)]
    best = min(climbs, key=lambda result: result.cost)
    jacobian = np.asarray(best.jac)
    # The residuals include the prior's: they make this invertible, whatever the log tells.
    information = jacobian.T @ jacobian
    whitened = Whitened(density, best.x, np.linalg.inv(information))
    # J'J lacks the second derivatives, which the density's own curvature has.
    mode, covariance_of_z = find_mode(whitened, np.zeros(best.x.size))
    point = whitened.points(mode[None])[0]
    covariance = whitened.covariance(covariance_of_z)
    order = _by_resonance(point, terms)
    # A mode takes its priors along, and gets the name of its new place.
    in_order = [
        dataclasses.replace(parameters[i], name=name)
        for name, i in zip(density.names, order, strict=True)
    ]
    ordered = DeviceDensity(density.model, spectra, in_order)
    return DeviceFit(ordered, point[order], covariance[np.ix_(order, order)])


def climb(density: DeviceDensity, start: Array) -> optimize.OptimizeResult:
    """Climb by least squares to the mode nearest to a start.

    Parameters
    ----------
    density : DeviceDensity
        Of a log.
    start : ndarray, shape (d,)
        Log parameters.

    Returns
    -------
    scipy.optimize.OptimizeResult
        `x` holds the log parameters of the mode.
    """
    return optimize.least_squares(density.residuals, start, method="lm")


def _by_resonance(point: Array, terms: Terms) -> list[int]:
    """Return the order of coordinates in which the modes' resonances rise."""
    first_of_modes = point.size - OF_A_MODE * terms.modes
    mass = np.arange(first_of_modes, point.size, OF_A_MODE)
    # A mode's parameters are its mass, stiffness and damping, in this order, after all others.
    stiffness = mass + 1
    log_resonance_squared = point[stiffness] - point[mass]
    rising = np.argsort(log_resonance_squared)
    order = list(range(first_of_modes))
    for first in mass[rising].tolist():
        order += range(first, first + OF_A_MODE)
    return order
