"""One study of a calibration: drawn from the prior, fitted, and its true values placed in the posterior."""

from __future__ import annotations

import dataclasses
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.calibration.sbc_plan import SBC_DESIGNS, SbcPlan
from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.models import IntervalEstimands, Pooled
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import Statistics, from_trials
from percept.inference.sampling.run import Run, Settings, sample
from percept.simulate import (
    Design,
    Responses,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    draw_responses,
)

Array = NDArray[np.float64]
_SNOOKER_STEPS = 150


@dataclasses.dataclass(frozen=True)
class Placed:
    """Where the true values of one study lie in its posterior."""

    reason: str  # Why there is nothing: what the gate said, or the refusal
    values: dict[str, float]


def place_study(plan: SbcPlan, index: int) -> Placed:
    """Simulate study `index` of a plan, fit it and place its true values."""
    design = SBC_DESIGNS[plan.design]
    own = np.random.SeedSequence(plan.seed, spawn_key=(list(SBC_DESIGNS).index(plan.design), index))
    truth_seed, run_seed, draw_seed = own.spawn(3)
    rng = np.random.default_rng(truth_seed)
    priors = Priors()
    truth = draw_environments(draw_hyperparameters(design, priors, rng), design, rng)
    statistics = _statistics(design, draw_responses(truth, design, rng))
    user = _new_user(truth, rng)
    model = _model(plan, statistics, priors)
    watched = IntervalEstimands(model, kinds=("mean", "user"))
    settings = Settings(tolerance=plan.tolerance, seed=int(run_seed.generate_state(1)[0]))
    try:
        run = sample(model, watched, settings)
    except RefusalError as refusal:
        return Placed(str(refusal), {})
    if not run.gate.passed:
        return Placed(" ".join(run.gate.reasons), {})
    return Placed("", _places(plan, model, run, truth, user, np.random.default_rng(draw_seed)))


def _statistics(design: Design, responses: Responses) -> Statistics:
    return from_trials(
        responses.y,
        responses.subject,
        responses.environment,
        design.decades.T,
        parameters=design.parameters,
        environments=design.environments,
        subjects=design.subjects,
    )


def _new_user(truth: TrueValues, rng: np.random.Generator) -> Array:
    """Point of equality of one more user in every environment, (P, J)."""
    total = truth.cov_u + truth.cov_w
    noise = rng.standard_normal(truth.beta.shape)
    return (truth.beta + np.einsum("jpq,jq->jp", np.linalg.cholesky(total), noise)).T


class _WithoutJacobian(Pooled):
    """A deliberate error: the prior of log sigma taken as a density of sigma squared."""

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,), wrong by twice the sum of log sigma."""
        inside = np.clip(points, -self.density.layout.limits, self.density.layout.limits)
        with np.errstate(over="ignore"):
            sigma = self.scales(inside)["sigma"][1]
        with np.errstate(divide="ignore"):
            return super().__call__(points) + 2.0 * np.log(sigma).reshape(len(points), -1).sum(axis=1)


def _model(plan: SbcPlan, statistics: Statistics, priors: Priors) -> Pooled:
    if plan.fault == "prior":
        priors = dataclasses.replace(priors, log_s_sd=0.1 * priors.log_s_sd)
    density = CollapsedDensity(statistics, priors)
    return _WithoutJacobian(density) if plan.fault == "jacobian" else Pooled(density)


def _places(
    plan: SbcPlan, model: Pooled, run: Run, truth: TrueValues, user: Array, rng: np.random.Generator
) -> dict[str, float]:
    points = np.concatenate(run.independent())
    if plan.fault == "snooker":
        points = _by_snooker(model, run, rng)
    laws = model.laws(points)
    chosen = points[rng.choice(len(points), size=plan.draws, replace=False)]
    beta = truth.beta.T.ravel()
    found: dict[str, float] = {}
    for name, (_, values) in model.scales(chosen).items():
        true = _true(truth, name)
        below = (values.reshape(plan.draws, -1) < true).sum(axis=0)
        found |= _named(name, (below + 0.5) / (plan.draws + 1), model)
    below = (model.draw(chosen, rng)[0] < beta).sum(axis=0)
    found |= _named("beta", (below + 0.5) / (plan.draws + 1), model)
    found |= _named("mean", special.ndtr((beta - laws.mean) / laws.sd).mean(axis=0), model)
    spread = np.hypot(laws.sd, laws.population_sd)
    found |= _named("user", special.ndtr((user.ravel() - laws.mean) / spread).mean(axis=0), model)
    return found


def _by_snooker(model: Pooled, run: Run, rng: np.random.Generator) -> Array:
    """Last positions of walkers that go on from a right run by emcee's snooker move alone."""
    start = run.points[:, -1].reshape(-1, run.points.shape[-1])
    sampler = emcee.EnsembleSampler(*start.shape, model, moves=emcee.moves.DESnookerMove(), vectorize=True)
    state = np.random.RandomState(int(rng.integers(2**32))).get_state()
    first = emcee.State(start, random_state=state)
    return sampler.run_mcmc(first, _SNOOKER_STEPS, store=False, skip_initial_state_check=True).coords


def _true(truth: TrueValues, name: str) -> Array:
    """Return the true values of a named scale, in the order of the model's."""
    owner: Any = truth if hasattr(truth, name) else truth.hyper
    return np.ravel(np.transpose(getattr(owner, name)))


def _named(name: str, values: Array, model: Pooled) -> dict[str, float]:
    """Label values by cell, parameter or not at all, as many as there are."""
    parameters = model.density.statistics.parameters
    labels = [f"[{p},{e}]" for p, e in model.cells]
    if name in ("s", "s_e", "kappa", "kappa_e", "omega", "omega_e", "sigma_u", "tau"):
        labels = [f"[{p}]" for p in parameters]
    elif name.startswith("rho"):
        labels = [""]
    return {name + label: float(value) for label, value in zip(labels, values, strict=True)}
