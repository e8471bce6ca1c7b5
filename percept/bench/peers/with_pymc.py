"""The model as users of PyMC write it, sampled by PyMC or by nutpie."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from percept.bench.peers.chains import fitted
from percept.bench.peers.engines import Fitted, Sampler
from percept.bench.peers.responses import Responses

_CHAINS = 4


def build(study: Responses, *, form: str = "centred") -> Any:
    """Write the model."""
    import pymc as pm

    cell, person = (2, study.environments), (2, study.subjects)
    with pm.Model() as model:
        alpha = pm.Normal("alpha", 0.0, 1.0, shape=2)
        gamma = pm.Normal("gamma", 0.0, 0.25, shape=2)
        tau = pm.HalfNormal("tau", 0.5, shape=2)
        sigma_u = pm.HalfNormal("sigma_u", 0.5, shape=2)
        log_s = pm.Normal("log_s", np.log(0.2), 1.0, shape=2)
        kappa = pm.Normal("kappa", 0.0, 0.5, shape=2)
        omega = pm.HalfNormal("omega", 1.0, shape=2)
        rho_u = pm.Deterministic("rho_u", 2.0 * pm.Beta("half_rho_u", 2.0, 2.0) - 1.0)
        rho_w = pm.Deterministic("rho_w", 2.0 * pm.Beta("half_rho_w", 2.0, 2.0) - 1.0)
        trend = log_s[:, None] + kappa[:, None] * study.decades
        if form == "centred":
            delta = pm.Normal("delta", 0.0, tau[:, None], shape=cell)
            log_sigma = pm.Normal("log_sigma", trend, omega[:, None], shape=cell)
        else:
            delta = pm.Deterministic("delta", tau[:, None] * pm.Normal("z_delta", shape=cell))
            log_sigma = pm.Deterministic(
                "log_sigma", trend + omega[:, None] * pm.Normal("z_sigma", shape=cell)
            )
        z = pm.Normal("z_u", shape=person)
        u_b = sigma_u[1] * (rho_u * z[0] + pm.math.sqrt(1.0 - rho_u**2) * z[1])
        u = pm.Deterministic("u", pm.math.stack([sigma_u[0] * z[0], u_b]))
        beta = pm.Deterministic("beta", alpha[:, None] + gamma[:, None] * study.decades + delta)
        sigma = pm.math.exp(log_sigma)
        pm.Deterministic("spread", pm.math.sqrt(sigma_u[:, None] ** 2 + sigma**2))
        mean = beta[:, study.environment] + u[:, study.subject]
        sd = sigma[:, study.environment]
        k, b = study.response.T
        pm.Normal("k", mean[0], sd[0], observed=k)
        given_k = mean[1] + rho_w * sd[1] / sd[0] * (k - mean[0])
        pm.Normal("b", given_k, sd[1] * pm.math.sqrt(1.0 - rho_w**2), observed=b)
    return model


def prepare(study: Responses, source: str, *, sampler: str, form: str) -> Sampler:
    """Build the model and, for nutpie, compile it."""
    del source
    return {"pymc": _pymc, "nutpie": _nutpie}[sampler](build(study, form=form))


def _pymc(model: Any) -> Sampler:
    import pymc as pm

    def sample(budget: float, seed: int) -> Fitted:
        draws = int(budget)
        with model:
            tree = pm.sample(
                draws, tune=1000, chains=_CHAINS, cores=os.cpu_count(), random_seed=seed,
                progressbar=False, compute_convergence_checks=False,
            )  # fmt: skip
        return _fitted(tree, seed, float(tree.posterior.attrs["sampling_time"]))

    return sample


def _nutpie(model: Any) -> Sampler:
    import nutpie

    compiled = nutpie.compile_pymc_model(model)

    def sample(budget: float, seed: int) -> Fitted:
        draws = int(budget)
        started = time.perf_counter()
        tree = nutpie.sample(
            compiled, draws=draws, tune=400, chains=_CHAINS, cores=os.cpu_count(), seed=seed,
            progress_bar=False,
        )  # fmt: skip
        return _fitted(tree, seed, time.perf_counter() - started)

    return sample


def _fitted(tree: Any, seed: int, seconds: float) -> Fitted:
    beta, spread = (np.asarray(tree.posterior[name]) for name in ("beta", "spread"))
    return fitted(beta, spread, seed, seconds, {"divergences": float(tree.sample_stats.diverging.sum())})
