"""The whole model as PyMC writes it, with repeats, missing cells and one or two parameters; nutpie on it.

Cell means and the scatter between trials are what is observed. The effect of a subject in an
environment is summed into the cell means' covariance; every other unknown is sampled.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, block
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Scales
from percept.inference.hierarchy.statistics import Statistics

Array = NDArray[np.float64]
_CHAINS, _TUNE, _DRAWS = 4, 2000, 10_000
#: Shorter steps than by default: divergences would bias what percept is compared with.
_ACCEPTANCE = 0.95
#: Draws per chain below which there are no limits.
_FEWEST = 100
#: What the limits need.
_SCALES = ("tau", "sigma_u", "rho_u", "sigma", "rho_w", "sigma_e", "rho_e")


def cells_model(statistics: Statistics, priors: Priors, *, centred: bool = False) -> Any:
    """Write the model in PyMC: plainly, or with shifts and spreads as multiples of their SDs (no funnel)."""
    import pymc as pm

    size, environments = statistics.x.shape
    person, cell = np.nonzero(np.isfinite(statistics.cell_means[:, 0]))
    mean = statistics.cell_means[person, :, cell]
    trials = np.zeros((len(statistics.subjects), environments))
    for pattern in statistics.patterns:
        trials[np.ix_(pattern.members, pattern.environments)] = pattern.trials
    trials = trials[person, cell]
    x = statistics.x

    def correlation(name: str) -> Any:
        if size == 1:
            return 0.0
        half = pm.Beta(f"half_{name}", priors.rho_shape, priors.rho_shape)
        return pm.Deterministic(name, 2.0 * half - 1.0)

    def about(centre: Any, sd: Any, name: str, multiple: str) -> Any:
        if centred:
            return pm.Normal(name, centre, sd[:, None], shape=(size, environments))
        return centre + sd[:, None] * pm.Normal(multiple, shape=(size, environments))

    def spreads(suffix: str) -> Any:
        log_s = pm.Normal(
            "log_s" + suffix, getattr(priors, f"log_s{suffix}_mean"), getattr(priors, f"log_s{suffix}_sd"),
            shape=size,
        )  # fmt: skip
        kappa = pm.Normal("kappa" + suffix, 0.0, getattr(priors, f"kappa{suffix}_sd"), shape=size)
        omega = pm.HalfNormal("omega" + suffix, getattr(priors, f"omega{suffix}_scale"), shape=size)
        log_sigma = about(
            log_s[:, None] + kappa[:, None] * x, omega, "log_sigma" + suffix, "z" + suffix
        )
        return pm.Deterministic("sigma" + suffix, pm.math.exp(log_sigma))

    with pm.Model() as model:
        tau = pm.HalfNormal("tau", priors.tau_scale, shape=size)
        alpha = pm.Normal("alpha", 0.0, priors.alpha_sd, shape=size)
        gamma = pm.Normal("gamma", 0.0, priors.gamma_sd, shape=size)
        delta = about(0.0, tau, "delta", "z_delta")
        beta = pm.Deterministic("beta", alpha[:, None] + gamma[:, None] * x + delta)
        sigma, rho_w = spreads(""), correlation("rho_w")
        sigma_u, rho_u = (
            pm.HalfNormal("sigma_u", priors.sigma_u_scale, shape=size),
            correlation("rho_u"),
        )
        z = pm.Normal("z_u", shape=(size, len(statistics.subjects)))
        u = [sigma_u[0] * z[0]]
        if size == 2:
            u.append(sigma_u[1] * (rho_u * z[0] + pm.math.sqrt(1.0 - rho_u**2) * z[1]))
        pm.Deterministic("spread", pm.math.sqrt(sigma_u[:, None] ** 2 + sigma**2))
        variance = [sigma[p][cell] ** 2 for p in range(size)]
        shared = rho_w * (sigma[0] * sigma[-1])[cell]
        if statistics.repeats:
            sigma_e, rho_e = spreads("_e"), correlation("rho_e")
            variance = [v + sigma_e[p][cell] ** 2 / trials for p, v in enumerate(variance)]
            shared = shared + rho_e * (sigma_e[0] * sigma_e[-1])[cell] / trials
            pm.Potential("scatter", _scatter_density(statistics, sigma_e, rho_e))
        off = mean[:, 0] - beta[0][cell] - u[0][person]
        pm.Normal("k", off, pm.math.sqrt(variance[0]), observed=np.zeros(len(mean)))
        if size == 2:
            given_k = beta[1][cell] + u[1][person] + shared / variance[0] * off
            left = variance[1] - shared**2 / variance[0]
            pm.Normal("b", given_k, pm.math.sqrt(left), observed=mean[:, 1])
    return model


def _scatter_density(statistics: Statistics, sigma_e: Any, rho_e: Any) -> Any:
    """Log density of the scatter between trials, summed over environments, without its constant."""
    import pymc as pm

    rows, df = statistics.trial_rows, statistics.trial_df
    scatter = np.einsum("pkj,qkj->pqj", rows, rows)
    if len(scatter) == 1:
        return -(df * pm.math.log(sigma_e[0]) + 0.5 * scatter[0, 0] / sigma_e[0] ** 2).sum()
    left = 1.0 - rho_e**2
    squares = scatter[0, 0] / sigma_e[0] ** 2 + scatter[1, 1] / sigma_e[1] ** 2
    squares = squares - 2.0 * rho_e * scatter[0, 1] / (sigma_e[0] * sigma_e[1])
    log_sd = pm.math.log(sigma_e[0]) + pm.math.log(sigma_e[1]) + 0.5 * pm.math.log(left)
    return -(df * log_sd + 0.5 * squares / left).sum()


def nutpie_limits(statistics: Statistics, seed: int, *, seconds: float) -> dict[str, Any]:
    """Sample for at most so long; limits of kinds mean and user, their errors, and what the run said."""
    import nutpie

    model = cells_model(statistics, Priors())
    compiled = nutpie.compile_pymc_model(
        model, var_names=[name for name in _SCALES if name in model]
    )
    started = time.perf_counter()
    # A thread per chain, whatever the processors: a run that is cut short then has draws of every
    # chain.
    sampler = nutpie.sample(
        compiled, draws=_DRAWS, tune=_TUNE, chains=_CHAINS, cores=_CHAINS, seed=seed,
        target_accept=_ACCEPTANCE, progress_bar=False, save_warmup=False, blocking=False,
    )  # fmt: skip
    try:
        tree = sampler.wait(timeout=seconds)
    except TimeoutError:
        tree = sampler.abort()
    wall = time.perf_counter() - started
    scales = {name: np.asarray(tree.posterior[name]) for name in _SCALES if name in tree.posterior}
    # Chains cut short are filled up with NaN.
    done = np.isfinite(scales["sigma_u"][..., 0]).sum(axis=1)
    if done.min() < _FEWEST:
        return {"cost": {"peer_s": wall, "peer_draws": int(done.sum())}}
    value, error = averaged_limits(
        statistics, {name: kept[:, : done.min()] for name, kept in scales.items()}
    )
    cost = {
        "peer_s": wall, "peer_draws": int(_CHAINS * done.min()),
        "divergences": int(np.nansum(tree.sample_stats.diverging)),
    }  # fmt: skip
    return {"cost": cost, "value": value.tolist(), "error": error.tolist()}


def averaged_limits(statistics: Statistics, draws: Mapping[str, Array]) -> tuple[Array, Array]:
    """Limits and their errors from draws of the scales, (chains, draws, ...) by name.

    Given the scales the locations are normal: their distribution functions are averaged, as percept
    does.
    """
    from arviz_stats.base.array import BaseArray

    array_stats: Any = BaseArray()
    model = CollapsedDensity(statistics)
    chains, length = draws["sigma_u"].shape[:2]
    # Draws last.
    flat = {
        name: np.moveaxis(kept.reshape(chains * length, *kept.shape[2:]), 0, -1)
        for name, kept in draws.items()
    }
    step = model.draws_per_pass
    packed = [
        model.moments(
            _scales({name: kept[..., i : i + step] for name, kept in flat.items()})
        ).pack()
        for i in range(0, chains * length, step)
    ]
    parts = list(IntervalEstimands(model, kinds=("mean", "user")).estimates(np.concatenate(packed)))
    influence = np.concatenate([part for _, part in parts], axis=1)
    series = np.moveaxis(influence.reshape(chains, length, -1), -1, 0)
    value = np.concatenate([found.value for found, _ in parts])
    return value, np.asarray(array_stats.mcse(series, method="mean"))


def _scales(named: dict[str, Array]) -> Scales:
    """Scales as percept's conditional laws take them; the density of coordinates plays no part."""

    def covariance(sd: str, rho: str) -> Block:
        correlation = named.get(rho)
        rest = None if correlation is None else 1.0 - np.abs(correlation)
        return block(tuple(named[sd]), correlation, rest)

    trial = covariance("sigma_e", "rho_e") if "sigma_e" in named else None
    return Scales(
        covariance("sigma", "rho_w"), covariance("sigma_u", "rho_u"), trial, tuple(named["tau"]), named,
        np.zeros(named["tau"].shape[-1]),
    )  # fmt: skip
