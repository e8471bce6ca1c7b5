"""The whole model written plainly in PyMC, for nutpie: the same limits by another density.

Locations, deviations and subjects' effects are unknowns. Only a subject's departure in a cell is
summed into the scatter of the cell's mean. It needs the extra `peers`.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reports.fitted import LEVEL, Fitted
from reports.studies import Array, Observed

#: A number or an array of PyMC, or of numpy; PyMC has no types.
Term = Any

#: nutpie's default is 6; R-hat needs several.
CHAINS = 4
_WARM_UP = 400  # Draws that are not kept, as its users take them


class _Plain:
    """Unknowns of the model, written inside a PyMC model; quantities first."""

    def __init__(self, observed: Observed) -> None:
        self.observed = observed
        self.priors = observed.priors
        self.size, self.cells = observed.x.shape

    def normal(self, name: str, sd: Term, *shape: int, centre: Term = 0.0) -> Term:
        """Return normal unknowns of each quantity."""
        import pymc as pm

        return pm.Normal(name, centre, sd, shape=(self.size, *shape))

    def half(self, name: str, scale: float) -> Term:
        """Return a half-normal unknown of each quantity."""
        import pymc as pm

        return pm.HalfNormal(name, scale, shape=self.size)

    def correlation(self, name: str) -> Term:
        """Return the correlation of both quantities; 0 for one."""
        import pymc as pm

        if self.size == 1:
            return 0.0
        shape = self.priors.rho_shape
        return pm.Deterministic(name, 2.0 * pm.Beta(f"half_{name}", shape, shape) - 1.0)

    def deviations(self, name: str) -> Term:
        """Return what each environment has of its own, at the cells."""
        tau = self.half(name, self.priors.tau_scale)
        environment = self.observed.environment
        count = int(environment.max()) + 1
        return self.normal(f"own_{name}", tau[:, None], count)[:, environment]

    def locations(self) -> Term:
        """Return the means of the cells."""
        import pymc as pm

        beta = self.normal("alpha", self.priors.alpha_sd)[:, None]
        beta = beta + self.normal("gamma", self.priors.gamma_sd)[:, None] * self.observed.x
        beta = beta + self.deviations("tau")
        for term, contrast in self.observed.contrast.items():
            coefficient = self.normal(f"lambda_{term}", self.priors.lambda_sd)[:, None]
            beta = beta + contrast * (coefficient + self.deviations(f"tau_{term}"))
        return pm.Deterministic("beta", beta)

    def sds(self, suffix: str) -> Term:
        """Return the SDs of all cells: "" between subjects, "_e" between trials."""
        import pymc as pm

        prior = vars(self.priors)
        sd = prior[f"log_s{suffix}_sd"]
        log_s = self.normal(f"log_s{suffix}", sd, centre=prior[f"log_s{suffix}_mean"])
        kappa = self.normal(f"kappa{suffix}", prior[f"kappa{suffix}_sd"])
        trend = log_s[:, None] + kappa[:, None] * self.observed.x
        for factor in self.observed.factors:
            psi = self.normal(f"psi{suffix}_{factor}", prior["psi_sd"])[:, None]
            trend = trend + psi * self.observed.contrast[factor]
        omega = self.half(f"omega{suffix}", prior[f"omega{suffix}_scale"])
        log_sigma = self.normal(f"log_sigma{suffix}", omega[:, None], self.cells, centre=trend)
        return pm.Deterministic(f"sigma{suffix}", pm.math.exp(log_sigma))

    def stretch(self) -> Term:
        """Return the sizes of subjects' effects in the cells."""
        import pymc as pm

        log_size: Term = np.zeros((self.size, self.cells))
        for factor in self.observed.spread:
            eta = self.normal(f"eta_{factor}", self.priors.psi_sd)[:, None]
            log_size = log_size + eta * self.observed.contrast[factor]
        return pm.Deterministic("stretch", pm.math.exp(log_size))

    def effects(self, stretch: Term) -> tuple[Term, Term]:
        """Return what every subject adds to the cells, (P, N, C), and its variance, (P, C)."""
        import pymc as pm

        total: Term = 0.0
        variance: Term = 0.0
        for name, contrast in self.observed.columns.items():
            sd = self.half(f"sigma_{name}", self.priors.sigma_u_scale)
            rho = self.correlation(f"rho_{name}")
            z = self.normal(f"z_{name}", 1.0, self.observed.subjects)
            effects = [sd[0] * z[0]]
            if self.size == 2:
                effects.append(sd[1] * (rho * z[0] + pm.math.sqrt(1.0 - rho**2) * z[1]))
            column = stretch * contrast
            total = total + pm.math.stack(effects)[:, :, None] * column[:, None, :]
            variance = variance + (sd[:, None] * column) ** 2
        return total, variance


def plain_model(observed: Observed) -> Any:
    """Write the model of a study without a covariate in PyMC.

    Parameters
    ----------
    observed : Observed
        The study.

    Returns
    -------
    pymc.Model
        `beta` are the means of the cells, and `spread` SDs between users, (P, C).
    """
    # PyMC and nutpie import arviz-plots if it is there. Release 0.8 wants this module, which
    # matplotlib 3.11 no longer imports itself.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import matplotlib.style.core  # noqa: F401
    import pymc as pm

    _, cells = observed.x.shape
    pair, of_trial, trials = np.unique(
        observed.subject * cells + observed.cell, return_inverse=True, return_counts=True
    )
    subject, cell = np.divmod(pair, cells)

    def summed(values: Array) -> Array:
        return np.bincount(of_trial, weights=values, minlength=len(pair)).astype(float)

    mean = np.stack([summed(column) / trials for column in observed.response.T])
    departure = observed.response.T - mean[:, of_trial]
    with pm.Model() as model:
        plain = _Plain(observed)
        beta = plain.locations()
        shared, variance_u = plain.effects(plain.stretch())
        residual = mean - beta[:, cell] - shared[:, subject, cell]
        sigma = plain.sds("")
        pm.Deterministic("spread", pm.math.sqrt(variance_u + sigma**2))
        covariance = _covariance(sigma[:, cell], plain.correlation("rho_w"))
        if trials.max() > 1:
            sigma_e = plain.sds("_e")[:, cell]
            if observed.own_trial_sds:
                omega_s = plain.half("omega_s", plain.priors.omega_s_scale)
                phi = omega_s[:, None] * plain.normal("z_phi", 1.0, observed.subjects)
                sigma_e = sigma_e * pm.math.exp(phi)[:, subject]
            within = _covariance(sigma_e, plain.correlation("rho_e"))
            squares = {}
            for p, q in within:
                squares[p, q] = summed(departure[p] * departure[q])
            # Departures from a mean of n trials have the density of n - 1 trials.
            pm.Potential("departures", _log_density(squares, within, trials - 1))
            covariance = {key: term + within[key] / trials for key, term in covariance.items()}
        squares = {(p, q): residual[p] * residual[q] for p, q in covariance}
        pm.Potential("means", _log_density(squares, covariance, np.ones(len(pair))))
    return model


_Pairs = dict[tuple[int, int], Term]


def _covariance(sd: Term, rho: Term) -> _Pairs:
    """Return variances, and the covariance where `rho` is one of two quantities."""
    if isinstance(rho, float):
        return {(0, 0): sd[0] ** 2}
    return {(0, 0): sd[0] ** 2, (1, 1): sd[1] ** 2, (0, 1): rho * sd[0] * sd[1]}


def _log_density(squares: _Pairs, covariance: _Pairs, counts: NDArray[Any]) -> Term:
    """Return the normal log density of sums of squares of so many values, without its constant."""
    import pymc as pm

    if len(covariance) == 1:
        variance = covariance[0, 0]
        return -0.5 * (squares[0, 0] / variance + counts * pm.math.log(variance)).sum()
    first = covariance[0, 0]
    second = covariance[1, 1]
    both = covariance[0, 1]
    determinant = first * second - both**2
    distance = second * squares[0, 0] + first * squares[1, 1] - 2.0 * both * squares[0, 1]
    return -0.5 * (distance / determinant + counts * pm.math.log(determinant)).sum()


def sampler(study: Observed) -> Callable[[float, int], Fitted]:
    """Compile the model of a study for nutpie.

    Parameters
    ----------
    study : Observed
        The study.

    Returns
    -------
    callable
        Takes the draws of each chain and a seed.
    """
    # First: it imports what nutpie's own imports want.
    model = plain_model(study)
    import nutpie

    names = ["beta", "spread"]
    compiled = nutpie.compile_pymc_model(model, var_names=names)

    def fit(draws: float, seed: int) -> Fitted:
        started = time.perf_counter()
        tree = nutpie.sample(
            compiled,
            draws=int(draws),
            tune=_WARM_UP,
            chains=CHAINS,
            cores=os.cpu_count(),
            seed=seed,
            progress_bar=False,
            save_warmup=False,
        )
        beta = np.asarray(tree.posterior["beta"])
        spread = np.asarray(tree.posterior["spread"])
        rng = np.random.default_rng(seed)
        limits = limits_of_draws(beta, spread, rng)
        notes = {"divergences": float(np.sum(tree.sample_stats.diverging))}
        return Fitted(*limits, time.perf_counter() - started, notes)

    return fit


def limits_of_draws(
    beta: Array, spread: Array, rng: np.random.Generator
) -> tuple[Array, Array, float]:
    """Return limits from raw draws, as quantiles.

    Parameters
    ----------
    beta, spread : ndarray, shape (chains, draws, …)
        Of the cells: means of the populations, and their SDs.
    rng : numpy.random.Generator
        Draws new users.

    Returns
    -------
    value, error : ndarray, shape (2, 2, cells)
        Limits of the kinds mean and user, and their Monte Carlo standard errors.
    effective : float
        Effective draws of the slowest quantity.
    """
    from arviz_stats.base.array import BaseArray

    beta = beta.reshape(*beta.shape[:2], -1)
    spread = spread.reshape(beta.shape)
    array_stats: Any = BaseArray()
    tails = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))

    def error_of(draws: Array, tail: float) -> Array:
        series = np.moveaxis(draws, -1, 0)
        return np.asarray(array_stats.mcse(series, method="quantile", prob=tail))

    value = []
    error = []
    user = beta + spread * rng.standard_normal(beta.shape)
    for draws in (beta, user):
        value.append(np.quantile(draws, tails, axis=(0, 1)))
        error.append([error_of(draws, tail) for tail in tails])
    effective = []
    for draws in (beta, np.log(spread)):
        series = np.moveaxis(draws, -1, 0)
        effective.append(array_stats.ess(series, method="bulk"))
        # 5 and 95 %: the tails whose draws are counted since Vehtari et al. (2021).
        effective.append(array_stats.ess(series, method="tail", prob=(0.05, 0.95)))
    return np.stack(value), np.stack(error), float(np.nanmin(effective))
