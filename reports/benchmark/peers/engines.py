"""The engines compared: each gives limits from a study's statistics."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from reports.benchmark.simulated import DESIGNS, observed, simulated, statistics_of

if TYPE_CHECKING:
    from percept.inference.model.interval_estimands import IntervalEstimands
    from percept.inference.model.model import Model
    from percept.inference.model.statistics import Statistics
    from percept.study.prepare import Prepared


Array: TypeAlias = NDArray[np.float64]

_KINDS = ("mean", "user", "share")
_LEVEL = 0.99
SHARE = 0.99
CONFIDENCE = 0.95
#: Studies compared, and what each is. The second part is simulated.
STUDIES = {
    "published": "10 subjects, 5 environments, one trial; k and b",
    "published-k": "10 subjects, 5 environments, one trial; k alone",
    "24x12x3-weak": (
        "24 subjects, 12 environments, 3 trials; scatter between subjects a fifth of the trials'"
    ),
    "20x100x1": "20 subjects, 100 environments, one trial; k and b",
}
_MOST_STEPS = 2_000_000  # Of percept, so that only its tolerance ends a run

_WALKERS = 256  # Of emcee, where the coordinates do not ask for more
_KEPT_EVERY = 10  # Steps of emcee
_BURN_IN = 0.25  # Of emcee's steps

_NUTPIE_TUNE = 400  # Of nutpie, as its users take them


@dataclass(frozen=True, eq=False)
class Fitted:
    """One run of an engine: limits on the response scale, and what it took."""

    value: Array  # (3, 2, C) Kinds, lower and upper, cells (parameter-major)
    error: Array  # (3, 2, C) Monte Carlo standard errors
    effective: float  # Effective draws of the slowest quantity behind them
    seconds: float  # Wall time of sampling and of the limits, without compiling
    notes: dict[str, float]  # What its user would look at: divergences, acceptance, steps


#: Samples within a budget, in the engine's own unit, from a seed.
Sampler: TypeAlias = Callable[[float, int], Fitted]


@dataclass(frozen=True)
class Engine:
    """One way to sample the model."""

    name: str
    title: str
    prepare: Callable[[Prepared], Sampler]
    packages: tuple[str, ...]  # Imported, and reported with their versions
    unit: str  # What a budget counts
    budgets: tuple[tuple[float, int], ...]  # Size and repeats of a full run, smallest first
    quick: float  # Size that is enough to see that it works

    @property
    def missing(self) -> tuple[str, ...]:
        """Packages that are not installed."""
        return tuple(name for name in self.packages if importlib.util.find_spec(name) is None)


def study_of(name: str) -> Prepared:
    """Return one of `STUDIES`."""
    if not name.startswith("published"):
        return simulated(DESIGNS[name], 1)
    from percept.scene import Scene
    from percept.sessions import read_sessions
    from percept.study.data import Data
    from percept.study.prepare import prepare
    from reports import dataset

    parameters = ("k",) if name == "published-k" else ("k", "b")
    sessions = read_sessions(dataset("hbfd_sessions.csv"))
    return prepare(Data(sessions, Scene()), parameters)


def _percept_model(statistics: Statistics) -> tuple[Model, IntervalEstimands]:
    """Return percept's model with its default priors, and the limits compared."""
    from percept.inference.model.interval_estimands import IntervalEstimands
    from percept.inference.model.linear_posterior import plain_model

    model = plain_model(statistics)
    estimands = IntervalEstimands(
        model, kinds=_KINDS, level=_LEVEL, share=SHARE, confidence=CONFIDENCE
    )
    return model, estimands


def percept_run(study: Prepared, tolerance: float, seed: int) -> Fitted:
    """Sample by percept to a tolerance."""
    from percept.inference.sampling.gate import Settings
    from percept.inference.sampling.run import sample

    started = time.perf_counter()
    model, estimands = _percept_model(statistics_of(study))
    run = sample(model, estimands, Settings(tolerance=tolerance, seed=seed, most_steps=_MOST_STEPS))
    gate = run.gate
    shape = (len(_KINDS), 2, len(estimands.cells))
    value = run.estimates.value.reshape(shape)
    error = run.errors.reshape(shape)
    notes = {
        "passed": float(gate.passed),
        "worst_error": gate.worst_error,
        "steps": float(run.steps),
        "autocorrelation_time": gate.autocorrelation_time,
        "acceptance": gate.acceptance,
    }
    seconds = time.perf_counter() - started
    return Fitted(value, error, gate.effective_draws, seconds, notes)


def _emcee(study: Prepared) -> Sampler:
    """Percept's density and mixture limits, emcee's own moves: what the moves alone cost."""
    import emcee

    from percept.inference.sampling.diagnostics import autocorrelation_time, normal_scores

    model, estimands = _percept_model(statistics_of(study))
    shape = (len(_KINDS), 2, len(estimands.cells))
    dimension = len(model.names)
    # emcee refuses an ensemble of fewer.
    walkers = max(_WALKERS, 2 * dimension)

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        steps = int(budget)
        points = 0.5 * np.random.default_rng(seed).standard_normal((walkers, dimension))
        sampler = emcee.EnsembleSampler(walkers, dimension, model, vectorize=True)
        # emcee takes nothing but a legacy state here, and ignores the rest in silence.
        random_state = np.random.RandomState(seed).get_state(legacy=True)
        state = emcee.State(points, random_state=random_state)
        sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        discarded = int(_BURN_IN * steps)
        chain = np.asarray(sampler.get_chain(discard=discarded, thin=_KEPT_EVERY))
        components = estimands.components(chain.reshape(-1, dimension))
        scores = normal_scores(components.reshape(*chain.shape[:2], -1))
        slowest = float(autocorrelation_time(scores[None]).max())
        effective = len(components) / slowest
        parts = list(estimands.estimates(components))
        value = np.concatenate([estimates.value for estimates, _ in parts])
        sd = np.concatenate([influence.std(axis=0) for _, influence in parts])
        error = sd / np.sqrt(effective)
        notes = {
            "acceptance": float(np.mean(sampler.acceptance_fraction)),
            "autocorrelation_time": slowest * _KEPT_EVERY,
        }
        seconds = time.perf_counter() - started
        return Fitted(value.reshape(shape), error.reshape(shape), effective, seconds, notes)

    return fit


def _nutpie(study: Prepared) -> Sampler:
    from reports.peers import nutpie_sampler, plain_model

    draw = nutpie_sampler(plain_model(observed(study), centred=True), ["beta", "spread"])

    def fit(budget: float, seed: int) -> Fitted:
        started = time.perf_counter()
        drawn = draw(int(budget), tune=_NUTPIE_TUNE, cores=os.cpu_count(), seed=seed)
        rng = np.random.default_rng(seed)
        limits = limits_of_draws(drawn.values["beta"], drawn.values["spread"], rng)
        seconds = time.perf_counter() - started
        return Fitted(*limits, seconds, {"divergences": float(drawn.divergences)})

    return fit


def share_half_widths(off: Array, spread: Array, share: float = SHARE) -> Array:
    """Return the half-width h with Phi((h - off)/spread) - Phi((-h - off)/spread) = share."""
    from scipy import special
    from scipy.optimize import elementwise

    def missing(t: Array, apart: Array) -> Array:
        return special.ndtr(apart - t) + special.ndtr(-apart - t) - (1.0 - share)

    apart = np.abs(off) / spread
    enough = apart + special.ndtri(0.5 * (1.0 + share)) + 1.0
    root = elementwise.find_root(missing, (np.zeros_like(apart), enough), args=(apart,))
    return np.asarray(root.x * spread)


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
    value, error : ndarray, shape (3, 2, cells)
        Limits of the kinds mean, user and share, and their Monte Carlo standard errors.
    effective : float
        Effective draws of the slowest quantity.
    """
    from arviz_stats.base.array import BaseArray

    beta = beta.reshape(*beta.shape[:2], -1)
    spread = spread.reshape(beta.shape)
    array_stats: Any = BaseArray()
    tails = (0.5 * (1.0 - _LEVEL), 0.5 * (1.0 + _LEVEL))

    def error_of_mean(draws: Array) -> Array:
        return np.asarray(array_stats.mcse(np.moveaxis(draws, -1, 0), method="mean"))

    def error_of_quantile(draws: Array, probability: float) -> Array:
        series = np.moveaxis(draws, -1, 0)
        return np.asarray(array_stats.mcse(series, method="quantile", prob=probability))

    value = []
    error = []
    user = beta + spread * rng.standard_normal(beta.shape)
    for draws in (beta, user):
        value.append(np.quantile(draws, tails, axis=(0, 1)))
        error.append([error_of_quantile(draws, tail) for tail in tails])
    centre = beta.mean(axis=(0, 1))
    half = share_half_widths(beta - centre, spread)
    h = np.quantile(half, CONFIDENCE, axis=(0, 1))
    value.append(np.stack([centre - h, centre + h]))
    of_share = np.hypot(error_of_quantile(half, CONFIDENCE), error_of_mean(beta))
    error.append([of_share, of_share])
    effective = []
    for draws in (beta, np.log(spread)):
        series = np.moveaxis(draws, -1, 0)
        effective.append(array_stats.ess(series, method="bulk"))
        # 5 and 95 %: the tails whose draws are counted since Vehtari et al. (2021).
        effective.append(array_stats.ess(series, method="tail", prob=(0.05, 0.95)))
    return np.stack(value), np.stack(error), float(np.nanmin(effective))


ENGINES = (
    Engine(
        "percept",
        "percept",
        lambda study: partial(percept_run, study),
        ("percept", "emcee", "numpy", "scipy"),
        "tolerance",
        ((0.1, 5), (0.02, 5), (0.01, 5), (0.005, 5), (0.002, 3), (0.001, 2)),
        0.1,
    ),
    Engine(
        "emcee",
        "emcee's stretch moves on percept's density",
        _emcee,
        ("percept", "emcee"),
        "steps of 256 walkers, or of twice the coordinates",
        ((1000, 5), (4000, 5), (16000, 3), (64000, 1)),
        200,
    ),
    Engine(
        "nutpie",
        "nutpie, written plainly",
        _nutpie,
        ("nutpie", "pymc", "pytensor", "numba"),
        "draws per chain, 4 chains",
        ((250, 5), (1000, 15), (4000, 3), (16000, 1)),
        50,
    ),
)


def engine(name: str) -> Engine:
    """Return the engine of that name."""
    by_name = {one.name: one for one in ENGINES}
    if name in by_name:
        return by_name[name]
    raise UsageError(f"no such engine; they are {', '.join(by_name)}.", key="engine", value=name)
