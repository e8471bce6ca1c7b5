"""The model as users of NumPyro write it, sampled by NUTS."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from percept.bench.peers.chains import fitted
from percept.bench.peers.engines import Fitted, Sampler
from percept.bench.peers.responses import Responses

_CHAINS, _TUNE = 4, 500
_PIECE = 250  # draws per call: a call of another length would be compiled again


def build(study: Responses, *, form: str = "centred") -> Any:
    """Write the model as a function without arguments."""
    import jax.numpy as jnp
    import numpyro
    import numpyro.distributions as dist

    cell, person = (2, study.environments), (2, study.subjects)
    decades, (k, b) = jnp.asarray(study.decades), jnp.asarray(study.response.T)
    who, where = jnp.asarray(study.subject), jnp.asarray(study.environment)

    def model() -> None:
        alpha = numpyro.sample("alpha", dist.Normal(0.0, 1.0).expand([2]))
        gamma = numpyro.sample("gamma", dist.Normal(0.0, 0.25).expand([2]))
        tau = numpyro.sample("tau", dist.HalfNormal(0.5).expand([2]))
        sigma_u = numpyro.sample("sigma_u", dist.HalfNormal(0.5).expand([2]))
        log_s = numpyro.sample("log_s", dist.Normal(jnp.log(0.2), 1.0).expand([2]))
        kappa = numpyro.sample("kappa", dist.Normal(0.0, 0.5).expand([2]))
        omega = numpyro.sample("omega", dist.HalfNormal(1.0).expand([2]))
        rho_u = 2.0 * numpyro.sample("half_rho_u", dist.Beta(2.0, 2.0)) - 1.0
        rho_w = 2.0 * numpyro.sample("half_rho_w", dist.Beta(2.0, 2.0)) - 1.0
        trend = log_s[:, None] + kappa[:, None] * decades
        if form == "centred":
            delta = numpyro.sample("delta", dist.Normal(jnp.zeros(cell), tau[:, None]))
            log_sigma = numpyro.sample("log_sigma", dist.Normal(trend, omega[:, None]))
        else:
            delta = tau[:, None] * numpyro.sample("z_delta", dist.Normal().expand(cell))
            log_sigma = trend + omega[:, None] * numpyro.sample("z_sigma", dist.Normal().expand(cell))
        z = numpyro.sample("z_u", dist.Normal().expand(person))
        u = jnp.stack([sigma_u[0] * z[0], sigma_u[1] * (rho_u * z[0] + jnp.sqrt(1.0 - rho_u**2) * z[1])])
        beta = numpyro.deterministic("beta", alpha[:, None] + gamma[:, None] * decades + delta)
        sigma = jnp.exp(log_sigma)
        numpyro.deterministic("spread", jnp.sqrt(sigma_u[:, None] ** 2 + sigma**2))
        mean, sd = beta[:, where] + u[:, who], sigma[:, where]
        numpyro.sample("k", dist.Normal(mean[0], sd[0]), obs=k)
        given_k = mean[1] + rho_w * sd[1] / sd[0] * (k - mean[0])
        numpyro.sample("b", dist.Normal(given_k, sd[1] * jnp.sqrt(1.0 - rho_w**2)), obs=b)

    return model


def prepare(study: Responses, source: str, *, form: str) -> Sampler:
    """Build the model; the first run compiles it."""
    del source
    import numpyro

    numpyro.enable_x64()
    numpyro.set_host_device_count(_CHAINS)
    import jax
    from numpyro.infer import MCMC, NUTS

    chains = MCMC(
        NUTS(build(study, form=form)), num_warmup=_TUNE, num_samples=_PIECE, num_chains=_CHAINS,
        progress_bar=False,
    )  # fmt: skip

    def sample(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        chains.warmup(jax.random.PRNGKey(seed))
        pieces, divergences = [], 0.0
        for _ in range(math.ceil(budget / _PIECE)):
            chains.post_warmup_state = chains.last_state
            chains.run(chains.last_state.rng_key, extra_fields=("diverging",))
            divergences += float(np.asarray(chains.get_extra_fields()["diverging"]).sum())
            posterior = chains.get_samples(group_by_chain=True)
            pieces.append([np.asarray(posterior[name]) for name in ("beta", "spread")])
        chains.post_warmup_state = None
        beta, spread = (np.concatenate(parts, axis=1) for parts in zip(*pieces, strict=True))
        return fitted(beta, spread, seed, time.perf_counter() - started, {"divergences": divergences})

    return sample
