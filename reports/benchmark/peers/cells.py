"""The whole model as PyMC writes it, with repeats, missing cells, one or two parameters.

Cell means and the scatter between trials are what is observed. The effect of a subject in an
environment is summed into the cell means' covariance; every other unknown is sampled.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, block
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.interval_estimands import IntervalEstimands
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Scales
from percept.inference.hierarchy.statistics import Statistics
from reports.benchmark.measure import Printed

__all__ = ["averaged_limits", "cells_model", "nutpie_limits"]

Array = NDArray[np.float64]
#: A number or an array of PyMC, or of numpy; PyMC has no types.
Term: TypeAlias = Any

#: nutpie's default is 6; R-hat needs several, and a run here has a thread for each.
_CHAINS = 4
#: Draws of each chain that are not kept; nutpie's default is 300 to 400: rare shapes adapt late.
_WARM_UP = 2000
#: Draws of each chain, unless time ends first.
_DRAWS = 10_000
#: Share of steps accepted: above the default of 0.8, for divergences would bias the comparison.
_ACCEPTANCE = 0.95
#: Draws per chain below which a limit's Monte Carlo error is itself unknown.
_FEWEST_DRAWS = 100
#: Scales that limits of kinds mean and user depend on, by their names in the model.
_SCALES = ("tau", "sigma_u", "rho_u", "sigma", "rho_w", "sigma_e", "rho_e")


@dataclass(frozen=True, eq=False)
class _Cells:
    """The C cells that have trials."""

    person: NDArray[np.intp]  # (C,)
    environment: NDArray[np.intp]  # (C,)
    mean: Array  # (C, parameters) Of each cell's trials
    trials: Array  # (C,) How many

    @classmethod
    def of(cls, statistics: Statistics) -> _Cells:
        person, environment = np.nonzero(np.isfinite(statistics.cell_means[:, 0]))
        trials = np.zeros((len(statistics.subjects), len(statistics.environments)))
        for pattern in statistics.patterns:
            trials[np.ix_(pattern.members, pattern.environments)] = pattern.trials
        mean = statistics.cell_means[person, :, environment]
        return cls(person, environment, mean, trials[person, environment])

    def variances(self, sigma: Term) -> list[Term]:
        """Variances of cells, one term per parameter, from SDs by parameter and environment."""
        return [sigma[p][self.environment] ** 2 for p in range(self.mean.shape[1])]

    def covariance(self, sigma: Term, rho: Term) -> Term:
        """Covariance of both parameters in cells, which one parameter does not need."""
        products = sigma[0] * sigma[-1]
        return rho * products[self.environment]


@dataclass(frozen=True, eq=False)
class _Terms:
    """Parts of the model, written inside a PyMC model."""

    x: Array  # (parameters, environments)
    priors: Priors
    centred: bool

    def correlation(self, name: str) -> Term:
        """Return the correlation of both parameters; 0 for one."""
        import pymc as pm

        if len(self.x) == 1:
            return 0.0
        half = pm.Beta(f"half_{name}", self.priors.rho_shape, self.priors.rho_shape)
        return pm.Deterministic(name, 2.0 * half - 1.0)

    def about(self, centre: Term, sd: Term, name: str, multiple: str) -> Term:
        """Return normal values, themselves unknowns or multiples of their SD."""
        import pymc as pm

        if self.centred:
            return pm.Normal(name, centre, sd[:, None], shape=self.x.shape)
        return centre + sd[:, None] * pm.Normal(multiple, shape=self.x.shape)

    def locations(self) -> Term:
        """Return β by parameter and environment."""
        import pymc as pm

        size = len(self.x)
        tau = pm.HalfNormal("tau", self.priors.tau_scale, shape=size)
        alpha = pm.Normal("alpha", 0.0, self.priors.alpha_sd, shape=size)
        gamma = pm.Normal("gamma", 0.0, self.priors.gamma_sd, shape=size)
        delta = self.about(0.0, tau, "delta", "z_delta")
        return pm.Deterministic("beta", alpha[:, None] + gamma[:, None] * self.x + delta)

    def subject_effects(self, subjects: int) -> tuple[Term, list[Term]]:
        """Return the SDs of the subjects' effects, and the effects parameter by parameter."""
        import pymc as pm

        size = len(self.x)
        sigma_u = pm.HalfNormal("sigma_u", self.priors.sigma_u_scale, shape=size)
        rho_u = self.correlation("rho_u")
        z = pm.Normal("z_u", shape=(size, subjects))
        effects = [sigma_u[0] * z[0]]
        if size == 2:
            uncorrelated = pm.math.sqrt(1.0 - rho_u**2) * z[1]
            effects.append(sigma_u[1] * (rho_u * z[0] + uncorrelated))
        return sigma_u, effects

    def spreads(self, suffix: str) -> Term:
        """Return SDs by parameter and environment: "" between subjects, "_e" between trials."""
        import pymc as pm

        size = len(self.x)
        prior = vars(self.priors)
        centre = prior[f"log_s{suffix}_mean"]
        sd = prior[f"log_s{suffix}_sd"]
        log_s = pm.Normal(f"log_s{suffix}", centre, sd, shape=size)
        kappa = pm.Normal(f"kappa{suffix}", 0.0, prior[f"kappa{suffix}_sd"], shape=size)
        omega = pm.HalfNormal(f"omega{suffix}", prior[f"omega{suffix}_scale"], shape=size)
        trend = log_s[:, None] + kappa[:, None] * self.x
        log_sigma = self.about(trend, omega, f"log_sigma{suffix}", f"z{suffix}")
        return pm.Deterministic(f"sigma{suffix}", pm.math.exp(log_sigma))


def cells_model(statistics: Statistics, priors: Priors, *, centred: bool = False) -> Any:
    """Write the model in PyMC.

    Parameters
    ----------
    statistics : Statistics
        What the density reads.
    priors : Priors
        Percept's.
    centred : bool
        Whether shifts and spreads are unknowns themselves, as a model is plainly written. By
        default they are multiples of their SDs, which leaves no funnel.

    Returns
    -------
    pymc.Model
        Its `beta` and `spread` are what limits need.
    """
    # PyMC and nutpie import arviz-plots if it is there. Release 0.8 wants this module, which
    # matplotlib 3.11 no longer imports itself.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import matplotlib.style.core  # noqa: F401
    import pymc as pm

    cells = _Cells.of(statistics)
    terms = _Terms(statistics.x, priors, centred)
    size = len(statistics.x)
    with pm.Model() as model:
        beta = terms.locations()
        sigma = terms.spreads("")
        rho_w = terms.correlation("rho_w")
        sigma_u, u = terms.subject_effects(len(statistics.subjects))
        pm.Deterministic("spread", pm.math.sqrt(sigma_u[:, None] ** 2 + sigma**2))
        variances = cells.variances(sigma)
        covariance = cells.covariance(sigma, rho_w)
        if statistics.repeats:
            sigma_e = terms.spreads("_e")
            rho_e = terms.correlation("rho_e")
            variances_e = cells.variances(sigma_e)
            for p in range(size):
                variances[p] += variances_e[p] / cells.trials
            covariance += cells.covariance(sigma_e, rho_e) / cells.trials
            pm.Potential("scatter", _scatter_density(statistics, sigma_e, rho_e))
        expected = [beta[p][cells.environment] + u[p][cells.person] for p in range(size)]
        # The density of both means: of k, and of b given k. Written so that zero is observed, k's
        # has the residual that b's needs.
        residual = cells.mean[:, 0] - expected[0]
        zero = np.zeros(len(cells.mean))
        pm.Normal("k", residual, pm.math.sqrt(variances[0]), observed=zero)
        if size == 2:
            b_given_k = expected[1] + covariance / variances[0] * residual
            remainder = variances[1] - covariance**2 / variances[0]
            pm.Normal("b", b_given_k, pm.math.sqrt(remainder), observed=cells.mean[:, 1])
    return model


def _scatter_density(statistics: Statistics, sigma_e: Term, rho_e: Term) -> Term:
    """Log density of the scatter between trials, summed over environments, without its constant."""
    import pymc as pm

    rows = statistics.trial_rows
    df = statistics.trial_df
    scatter = np.einsum("pkj,qkj->pqj", rows, rows)
    if len(scatter) == 1:
        square = scatter[0, 0] / sigma_e[0] ** 2
        return -(df * pm.math.log(sigma_e[0]) + 0.5 * square).sum()
    remainder = 1.0 - rho_e**2
    squares = scatter[0, 0] / sigma_e[0] ** 2 + scatter[1, 1] / sigma_e[1] ** 2
    squares -= 2.0 * rho_e * scatter[0, 1] / (sigma_e[0] * sigma_e[1])
    log_sds = pm.math.log(sigma_e[0]) + pm.math.log(sigma_e[1])
    log_sd = log_sds + 0.5 * pm.math.log(remainder)
    return -(df * log_sd + 0.5 * squares / remainder).sum()


def nutpie_limits(statistics: Statistics, seed: int, *, seconds: float) -> Printed:
    """Sample for at most `seconds`; limits of kinds mean and user, and what the run took."""
    model = cells_model(statistics, Priors())
    import nutpie

    scales = [name for name in _SCALES if name in model]
    compiled = nutpie.compile_pymc_model(model, var_names=scales)
    started = time.perf_counter()
    # A thread per chain, whatever the processors: a run cut short then has draws of every chain.
    sampler = nutpie.sample(
        compiled,
        draws=_DRAWS,
        tune=_WARM_UP,
        chains=_CHAINS,
        cores=_CHAINS,
        seed=seed,
        target_accept=_ACCEPTANCE,
        progress_bar=False,
        save_warmup=False,
        blocking=False,
    )
    try:
        tree = sampler.wait(timeout=seconds)
    except TimeoutError:
        tree = sampler.abort()
    wall = time.perf_counter() - started
    # Chains cut short are filled up with NaN.
    sigma_u = np.asarray(tree.posterior["sigma_u"])
    done = np.isfinite(sigma_u[..., 0]).sum(axis=1)
    length = int(done.min())
    if length < _FEWEST_DRAWS:
        return {"cost": {"peer_s": wall, "peer_draws": int(done.sum())}}
    draws = {name: np.asarray(tree.posterior[name])[:, :length] for name in scales}
    value, error = averaged_limits(statistics, draws)
    divergences = int(np.nansum(tree.sample_stats.diverging))
    cost = {"peer_s": wall, "peer_draws": _CHAINS * length, "divergences": divergences}
    return {"cost": cost, "value": value, "error": error}


def averaged_limits(statistics: Statistics, draws: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return limits of kinds mean and user from draws of the scales.

    Given the scales the locations are normal: their distribution functions are averaged, as percept
    does.

    Parameters
    ----------
    statistics : Statistics
        What the density reads.
    draws : mapping
        By name, (chains, draws, ...).

    Returns
    -------
    value, error : ndarray
        Limits on the response scale, and their Monte Carlo standard errors.
    """
    from arviz_stats.base.array import BaseArray

    array_stats: Any = BaseArray()
    model = CollapsedDensity(statistics)
    chains, length = draws["sigma_u"].shape[:2]
    count = chains * length
    flat = {}
    for name, values in draws.items():
        # Draws last.
        joined = values.reshape(count, *values.shape[2:])
        flat[name] = np.moveaxis(joined, 0, -1)
    packed = []
    step = model.draws_per_pass
    for start in range(0, count, step):
        batch = {name: values[..., start : start + step] for name, values in flat.items()}
        packed.append(model.moments(_scales(batch)).pack())
    estimands = IntervalEstimands(model, kinds=("mean", "user"))
    parts = list(estimands.estimates(np.concatenate(packed)))
    value = np.concatenate([estimates.value for estimates, _ in parts])
    influence = np.concatenate([influence for _, influence in parts], axis=1)
    series = np.moveaxis(influence.reshape(chains, length, -1), -1, 0)
    return value, np.asarray(array_stats.mcse(series, method="mean"))


def _scales(named: dict[str, Array]) -> Scales:
    """Return scales as percept's conditional laws take them; no coordinates stand behind them."""

    def covariance(sd: str, rho: str) -> Block:
        correlation = named.get(rho)
        rest = None if correlation is None else 1.0 - np.abs(correlation)
        return block(tuple(named[sd]), correlation, rest)

    return Scales(
        between=covariance("sigma", "rho_w"),
        shared=covariance("sigma_u", "rho_u"),
        trial=covariance("sigma_e", "rho_e") if "sigma_e" in named else None,
        tau=tuple(named["tau"]),
        named=named,
        log_prior=np.zeros(named["tau"].shape[-1]),
    )
