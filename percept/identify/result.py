"""From a log to a device: fit, bootstrap, posterior, and what the log cannot tell, as records."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.identify.bootstrap import bootstrap_sds
from percept.identify.fit import DeviceFit, fit_device
from percept.identify.log import Response
from percept.identify.model import Terms
from percept.identify.posterior import DevicePosterior, sample_device
from percept.identify.spectra import Periods, TimeLog, of_segments

__all__ = ["Identified", "ParameterEstimate", "Request", "identify"]

Array = NDArray[np.float64]

#: Logs that a bootstrap makes: an SD is known to 5 % by them.
_REPLICATES = 200
#: Segments of a log that does not repeat, where no length is given.
_SEGMENTS = 16
_LEVEL = 0.95


@dataclasses.dataclass(frozen=True, kw_only=True)
class Request:
    """How a log is to be read and fitted."""

    terms: Terms
    repeat: float | None = None  # s, period of the excitation
    segment: float | None = None  # s, of a log that does not repeat
    averages: int | None = None  # Segments behind a response and its coherence
    band: tuple[float, float] = (0.0, np.inf)  # rad/s
    seed: int = 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """One parameter; its numbers are None where the log does not tell it."""

    name: str
    unit: str
    value: float | None  # exp of the posterior mean of the logarithm
    lower: float | None  # 95 % of the posterior
    upper: float | None
    sd_log: float  # Of the logarithm under the posterior
    sd_log_information: float  # By the curvature of the density
    sd_log_bootstrap: float | None  # Over periods; None without periods
    prior_median: float
    not_identifiable: str  # Why; empty where it is


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """A device with all that is known of it from a log."""

    estimates: tuple[ParameterEstimate, ...]
    covariance: Array  # (d, d) Of the logarithms of all parameters under the posterior
    terms: Terms
    fits: bool  # Whether the device leaves no more than the noise
    misfit: float  # Deviance of a line over that of noise alone
    omega: Array  # (K,) rad/s
    repeats: int
    coherence: Array  # (K,)
    measured: NDArray[np.complex128]  # (K,) N·s/m, delay and friction included
    fitted: NDArray[np.complex128]  # (K,) The same of the device
    residuals: NDArray[np.complex128]  # (K,) In SDs of a mean's noise
    effective_draws: float  # Of the posterior
    rhat: float

    @property
    def unidentified(self) -> tuple[ParameterEstimate, ...]:
        """Parameters that the log does not tell."""
        return tuple(estimate for estimate in self.estimates if estimate.not_identifiable)


def identify(log: TimeLog | Response, request: Request) -> Identified:
    """Identify a device from a log.

    Parameters
    ----------
    log : TimeLog or Response
        As `percept.identify.log.read_log` gives it.
    request : Request
        How to read and fit it.

    Returns
    -------
    Identified

    Raises
    ------
    UsageError
        Friction asked of a response; a period that is no whole number of samples.
    RefusalError
        A log too short or too weak, or a posterior that the gate withholds.
    """
    periods = None
    if isinstance(log, Response):
        spectra = log.spectra(request.averages, request.band)
    elif request.repeat is not None:
        periods = Periods.of(log, request.repeat, request.band)
        spectra = periods.spectra()
    else:
        length = log.step * (log.force.size // _SEGMENTS)
        spectra = of_segments(log, request.segment or length, request.band)
    if request.terms.friction and periods is None:
        raise UsageError(
            "Coulomb friction is estimated from repeated periods of a log in time.",
            hint="Leave --friction out, or give the period of the excitation by --repeat.",
        )
    fit = fit_device(spectra, request.terms)
    posterior = sample_device(fit, seed=request.seed)
    bootstrap = None
    if periods is not None:
        rng = np.random.default_rng(request.seed)
        bootstrap = bootstrap_sds(fit, periods, _REPLICATES, rng)
    return _identified(fit, posterior, bootstrap)


def _identified(fit: DeviceFit, posterior: DevicePosterior, bootstrap: Array | None) -> Identified:
    """Put the numbers of a fit into records."""
    density = fit.density
    spectra = density.spectra
    reasons = fit.unidentified()
    value = np.exp(posterior.mean)
    lower, upper = posterior.interval(_LEVEL)
    sds = np.sqrt(np.diagonal(posterior.covariance))
    estimates = []
    for index, parameter in enumerate(density.parameters):
        reason = reasons.get(parameter.name, "")
        estimates.append(
            ParameterEstimate(
                name=parameter.name,
                unit=parameter.unit,
                value=None if reason else float(value[index]),
                lower=None if reason else float(lower[index]),
                upper=None if reason else float(upper[index]),
                sd_log=float(sds[index]),
                sd_log_information=float(fit.sd[index]),
                sd_log_bootstrap=None if bootstrap is None else float(bootstrap[index]),
                prior_median=parameter.median,
                not_identifiable=reason,
            )
        )
    force, _ = density.model.force(posterior.mean[None], spectra)
    standardized = density.standardized(posterior.mean[None])[0]
    return Identified(
        estimates=tuple(estimates),
        covariance=posterior.covariance,
        terms=density.model.terms,
        fits=fit.fits,
        misfit=fit.misfit,
        omega=spectra.omega,
        repeats=spectra.repeats,
        coherence=spectra.coherence,
        measured=spectra.response,
        fitted=force[0] / spectra.velocity,
        residuals=standardized * np.sqrt(spectra.repeats - 1.0),
        effective_draws=posterior.run.gate.effective_draws,
        rhat=posterior.run.gate.rhat,
    )
