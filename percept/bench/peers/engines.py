"""The engines compared, each as its users write it; what an engine needs is imported where it is used."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import os
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from percept.bench.peers.model import (
    CONFIDENCE,
    KINDS,
    LEVEL,
    SHARE,
    Array,
    Limits,
    PlainDensity,
    Responses,
    limits_of_draws,
    population,
)
from percept.errors import UsageError

if TYPE_CHECKING:
    from percept.inference.hierarchy.models import IntervalEstimands, Model


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """One run of an engine."""

    limits: dict[str, Limits]  # By how they are worked out: "mixture" of conditionals, "draws"
    seconds: float  # Wall time of sampling and of the limits, without compiling
    notes: dict[str, float]  # What its user would look at: divergences, acceptance, autocorrelation time


#: Samples within a budget, in the engine's own unit, from a seed.
Sampler: TypeAlias = Callable[[float, int], Fitted]


@dataclasses.dataclass(frozen=True)
class Engine:
    """One way to sample the model."""

    name: str
    title: str
    prepare: Callable[[Responses, str], Sampler]  # From the study as arrays and its session file
    packages: tuple[str, ...]  # Imported, and reported with their versions
    unit: str  # What a budget counts
    budgets: tuple[tuple[float, int], ...]  # Size and repeats of a full run, smallest first
    quick: float  # Size that is enough to see that it works

    @property
    def missing(self) -> tuple[str, ...]:
        """Packages that are not installed."""
        return missing_packages(self.packages)


def missing_packages(packages: tuple[str, ...]) -> tuple[str, ...]:
    """Return those that are not installed."""
    return tuple(name for name in packages if importlib.util.find_spec(name) is None)


# percept

_MOST_STEPS = 2_000_000


def percept_model(source: str) -> tuple[Model, IntervalEstimands]:
    """Read sessions; percept's model of them with its default priors, and the limits compared."""
    from percept.inference.hierarchy.models import IntervalEstimands
    from percept.scene import Scene
    from percept.sessions import read_sessions
    from percept.study.fit import prepare

    model = prepare(read_sessions(source), Scene(), ("k", "b")).model
    return model, IntervalEstimands(model, kinds=KINDS, level=LEVEL, share=SHARE, confidence=CONFIDENCE)


def _percept(study: Responses, source: str) -> Sampler:
    """Percept itself: sampled to a tolerance; limits from the mixture and from raw draws."""
    from percept.inference.hierarchy.density import ConditionalMoments
    from percept.inference.sampling.gate import Settings
    from percept.inference.sampling.run import sample

    model, estimands = percept_model(source)
    shape = (len(KINDS), 2, len(estimands.cells))

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        run = sample(model, estimands, Settings(tolerance=budget, seed=seed, most_steps=_MOST_STEPS))
        seconds = time.perf_counter() - started
        gate = run.gate
        # One conditional draw of the locations per kept draw of the scales.
        laws = ConditionalMoments.unpack(run.components.reshape(-1, run.components.shape[-1]))
        rng = np.random.default_rng(seed)
        beta = laws.mean + laws.sd * rng.standard_normal(laws.mean.shape)
        draws = limits_of_draws(beta[None], laws.population_sd[None], rng)
        limits = {
            "mixture": Limits(
                run.estimates.value.reshape(shape), run.errors.reshape(shape), gate.effective_draws
            ),
            "draws": dataclasses.replace(draws, effective=gate.effective_draws),
        }
        notes = {
            "passed": float(gate.passed), "worst_error": gate.worst_error, "steps": float(run.steps),
            "autocorrelation_time": gate.autocorrelation_time, "acceptance": gate.acceptance,
        }  # fmt: skip
        return Fitted(limits, seconds, notes)

    return fit


# emcee's stretch moves, on percept's density and on the joint one

_WALKERS = 256
_KEPT_EVERY = 10
_BURN_IN = 0.25


def _stretch(
    density: Callable[[Array], Array], points: Array, steps: int, seed: int
) -> tuple[Array, dict[str, float]]:
    """Run emcee as its tutorial does: kept positions (T, W, d) and its notes."""
    import emcee

    sampler = emcee.EnsembleSampler(_WALKERS, points.shape[1], density, vectorize=True)
    # emcee takes nothing but a legacy state here, and ignores the rest in silence.
    state = emcee.State(points, random_state=np.random.RandomState(seed).get_state(legacy=True))
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    chain = np.asarray(sampler.get_chain(discard=int(_BURN_IN * steps), thin=_KEPT_EVERY))
    return chain, {"acceptance": float(np.mean(sampler.acceptance_fraction))}


def _slowest(series: Array) -> float:
    """Longest autocorrelation time of series (T, W, quantities), in kept positions."""
    from percept.inference.sampling.diagnostics import autocorrelation_time, normal_scores

    return float(autocorrelation_time(normal_scores(series)[None]).max())


def _percept_stretch(study: Responses, source: str) -> Sampler:
    """Percept's collapsed density and mixture limits, emcee's stretch moves: what the moves alone cost."""
    model, estimands = percept_model(source)
    shape = (len(KINDS), 2, len(estimands.cells))

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        points = 0.5 * np.random.default_rng(seed).standard_normal((_WALKERS, len(model.names)))
        kept, notes = _stretch(model, points, int(budget), seed)
        components = estimands.components(kept.reshape(-1, kept.shape[2]))
        steps = _slowest(components.reshape(*kept.shape[:2], -1))
        effective = len(components) / steps
        estimates, influence = estimands.estimate(components)
        error = influence.std(axis=0) / np.sqrt(effective)
        limits = Limits(estimates.value.reshape(shape), error.reshape(shape), effective)
        notes["autocorrelation_time"] = steps * _KEPT_EVERY
        return Fitted({"mixture": limits}, time.perf_counter() - started, notes)

    return fit


def _emcee(study: Responses, source: str) -> Sampler:
    """Emcee on the joint density, nothing integrated out."""
    density = PlainDensity(study)

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        rng = np.random.default_rng(seed)
        kept, notes = _stretch(density, density.start(_WALKERS, rng), int(budget), seed)
        flat = kept.reshape(-1, density.dimension)
        beta, spread = population(density.unknowns(flat), study.decades)
        # Walkers are not chains: their draws are pooled in one, and the errors come from their own times.
        limits = limits_of_draws(beta[None], spread[None], np.random.default_rng(seed))
        steps = _slowest(np.concatenate([beta, np.log(spread)], axis=1).reshape(*kept.shape[:2], -1))
        effective = len(flat) / steps
        error = limits.error * np.sqrt(max(1.0, limits.effective / effective))
        notes["autocorrelation_time"] = steps * _KEPT_EVERY
        limits = Limits(limits.value, error, effective)
        return Fitted({"draws": limits}, time.perf_counter() - started, notes)

    return fit


# NUTS

_CHAINS = 4
_PIECE = 250  # NumPyro's draws per call: a call of another length would be compiled again


def _of_chains(beta: Any, spread: Any, seed: int, seconds: float, divergences: float) -> Fitted:
    """Limits from the draws (chains, draws, parameters, environments) of a general sampler."""
    started = time.perf_counter()
    chains, draws = beta.shape[:2]
    limits = limits_of_draws(
        beta.reshape(chains, draws, -1), spread.reshape(chains, draws, -1), np.random.default_rng(seed)
    )
    seconds += time.perf_counter() - started
    return Fitted({"draws": limits}, seconds, {"divergences": divergences})


def pymc_model(study: Responses, *, form: str = "centred") -> Any:
    """Write the model as users of PyMC do."""
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


def _pymc(study: Responses, source: str) -> Sampler:
    import pymc as pm

    model = pymc_model(study)

    def fit(budget: float, seed: int) -> Fitted:
        with model:
            tree = pm.sample(
                int(budget), tune=1000, chains=_CHAINS, cores=os.cpu_count(), random_seed=seed,
                progressbar=False, compute_convergence_checks=False,
            )  # fmt: skip
        return _of_tree(tree, seed, float(tree.posterior.attrs["sampling_time"]))

    return fit


def _nutpie(study: Responses, source: str, *, form: str) -> Sampler:
    """PyMC's model, compiled and sampled by nutpie."""
    import nutpie

    compiled = nutpie.compile_pymc_model(pymc_model(study, form=form))

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        tree = nutpie.sample(
            compiled, draws=int(budget), tune=400, chains=_CHAINS, cores=os.cpu_count(), seed=seed,
            progress_bar=False,
        )  # fmt: skip
        return _of_tree(tree, seed, time.perf_counter() - started)

    return fit


def _of_tree(tree: Any, seed: int, seconds: float) -> Fitted:
    beta, spread = (np.asarray(tree.posterior[name]) for name in ("beta", "spread"))
    return _of_chains(beta, spread, seed, seconds, float(tree.sample_stats.diverging.sum()))


def numpyro_model(study: Responses, *, form: str = "centred") -> Any:
    """Write the model as users of NumPyro do, a function without arguments."""
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


def _numpyro(study: Responses, source: str, *, form: str) -> Sampler:
    import numpyro

    numpyro.enable_x64()
    numpyro.set_host_device_count(_CHAINS)
    import jax
    from numpyro.infer import MCMC, NUTS

    chains = MCMC(
        NUTS(numpyro_model(study, form=form)), num_warmup=500, num_samples=_PIECE, num_chains=_CHAINS,
        progress_bar=False,
    )  # fmt: skip

    def fit(budget: float, seed: int) -> Fitted:
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
        return _of_chains(beta, spread, seed, time.perf_counter() - started, divergences)

    return fit


_NUTS_UNIT, _WALKERS_UNIT = "draws per chain, 4 chains", "steps of 256 walkers"
_NUTS_SIZES = ((250, 5), (1000, 5), (4000, 3), (16000, 1))
_WALKER_SIZES = ((1000, 5), (4000, 5), (16000, 3), (64000, 1))
_NUTPIE_SIZES = ((250, 5), (1000, 15), (4000, 3), (16000, 1))
_NUTPIE = ("nutpie", "pymc", "pytensor", "numba")
ENGINES = (
    Engine(
        "percept", "percept", _percept, ("percept", "emcee", "numpy", "scipy"), "tolerance",
        ((0.1, 5), (0.02, 5), (0.01, 5), (0.005, 5), (0.002, 3), (0.001, 2)), 0.1,
    ),
    Engine(
        "percept-stretch", "percept's density, emcee's stretch moves", _percept_stretch,
        ("percept", "emcee"), _WALKERS_UNIT, _WALKER_SIZES, 200,
    ),
    Engine(
        "emcee", "emcee, nothing integrated out", _emcee, ("emcee", "numpy"), _WALKERS_UNIT, _WALKER_SIZES,
        200,
    ),
    Engine(
        "nutpie", "nutpie, written plainly", partial(_nutpie, form="centred"), _NUTPIE, _NUTS_UNIT,
        _NUTPIE_SIZES, 50,
    ),
    Engine(
        "nutpie-noncentred", "nutpie, non-centred by hand", partial(_nutpie, form="noncentred"), _NUTPIE,
        _NUTS_UNIT, _NUTS_SIZES, 50,
    ),
    Engine("pymc", "PyMC, written plainly", _pymc, ("pymc", "pytensor"), _NUTS_UNIT, _NUTS_SIZES, 50),
    Engine(
        "numpyro", "NumPyro, written plainly", partial(_numpyro, form="centred"), ("numpyro", "jax"),
        _NUTS_UNIT, _NUTS_SIZES, 50,
    ),
    Engine(
        "numpyro-noncentred", "NumPyro, non-centred by hand", partial(_numpyro, form="noncentred"),
        ("numpyro", "jax"), _NUTS_UNIT, _NUTS_SIZES, 50,
    ),
)  # fmt: skip


def engine(name: str) -> Engine:
    """Return the engine of that name."""
    for candidate in ENGINES:
        if candidate.name == name:
            return candidate
    known = ", ".join(candidate.name for candidate in ENGINES)
    raise UsageError(f"no such engine; they are {known}.", key="engine", value=name)
