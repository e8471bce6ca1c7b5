"""One study of a calibration: drawn from the prior, fitted, and its true values placed in the posterior."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import Statistics, from_trials
from percept.inference.sampling.gate import Run, Settings
from percept.inference.sampling.run import sample
from percept.simulate.model import (
    Design,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    draw_responses,
)

Array = NDArray[np.float64]
_REFERENCES = np.array([[10.0, 0.1], [1e3, 1.0], [1e4, 10.0], [2.5e4, 25.0], [5e4, 50.0]])
_BY_PARAMETER = ("s", "s_e", "kappa", "kappa_e", "omega", "omega_e", "sigma_u", "tau")


#: Trials of eight subjects in four environments: two miss some, and one sees a single one.
_GAPS = np.ones((8, 4), dtype=np.int64)
_GAPS[[0, 2, 2, 5, 5, 5], [1, 0, 3, 1, 2, 3]] = 0
#: The kinds of study that are calibrated. Their order decides their seeds.
SBC_DESIGNS: dict[str, Design] = {
    "balanced": Design.balanced(_REFERENCES, subjects=10),
    "trials": Design.balanced(_REFERENCES[:3], subjects=8, trials=3),
    "missing cells": Design(_REFERENCES[:4], _GAPS),
    "one parameter": Design.balanced(_REFERENCES[:4, :1], subjects=8, parameters=("k",)),
    "one environment": Design.balanced(_REFERENCES[2:3], subjects=8),
    "three subjects": Design.balanced(_REFERENCES[:3], subjects=3),
    "weak scatter": Design.balanced(_REFERENCES, subjects=10, trials=3),
    "thirty environments": Design.balanced(np.geomspace([10.0, 0.1], [5e4, 50.0], 30), subjects=8),
}
#: Priors of truths and fits, where they are not the defaults. A twentieth of the scatter between
#: trials: the data can hardly tell the scatter between subjects from none.
_PRIORS = {"weak scatter": Priors(log_s_mean=math.log(0.005))}


@dataclasses.dataclass(frozen=True, kw_only=True)
class SbcPlan:
    """One design, to be simulated from the prior and fitted many times."""

    design: str  # One of `SBC_DESIGNS`
    seed: int = 1  # Of the whole
    draws: int = (
        199  # Independent posterior draws a true value is ranked among; one less than a multiple
    )
    bins: int = 20  # of the equal bins the ranks are counted in
    tolerance: float = 0.2  # Of the sampler, on the limits of kinds mean and user

    def __post_init__(self) -> None:
        if self.design not in SBC_DESIGNS:
            raise UsageError(
                f"no such design; there are {', '.join(SBC_DESIGNS)}.",
                key="design",
                value=self.design,
            )

    @property
    def key(self) -> str:
        """A digest that tells results of different plans apart."""
        # Kept fits were made when a plan could have a deliberate error.
        text = json.dumps(dataclasses.asdict(self) | {"fault": "none"}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def place_study(
    plan: SbcPlan,
    index: int,
    density: Callable[[Statistics, Priors], CollapsedDensity] = CollapsedDensity,
) -> dict[str, Any]:
    """Simulate study `index` of a plan, fit it and place its true values.

    `values` are none where there is a `reason`: what the gate said, or the refusal.
    """
    design = SBC_DESIGNS[plan.design]
    own = np.random.SeedSequence(plan.seed, spawn_key=(list(SBC_DESIGNS).index(plan.design), index))
    truth_seed, run_seed, draw_seed = own.spawn(3)
    rng = np.random.default_rng(truth_seed)
    priors = _PRIORS.get(plan.design, Priors())
    truth = draw_environments(draw_hyperparameters(design, priors, rng), design, rng)
    responses = draw_responses(truth, design, rng)
    statistics = from_trials(
        responses.y,
        responses.subject,
        responses.environment,
        design.decades.T,
        parameters=design.parameters,
        environments=design.environments,
        subjects=design.subjects,
    )
    # One more user in every environment.
    noise = rng.standard_normal(truth.beta.shape)
    user = truth.beta + np.einsum(
        "jpq,jq->jp", np.linalg.cholesky(truth.cov_u + truth.cov_w), noise
    )
    model = density(statistics, priors)
    settings = Settings(tolerance=plan.tolerance, seed=int(run_seed.generate_state(1)[0]))
    try:
        run = sample(model, IntervalEstimands(model, kinds=("mean", "user")), settings)
    except RefusalError as refusal:
        return {"reason": str(refusal), "values": {}}
    if not run.gate.passed:
        return {"reason": " ".join(run.gate.reasons), "values": {}}
    values = places(plan, model, run, truth, user.T.ravel(), np.random.default_rng(draw_seed))
    return {"reason": "", "values": values}


def places(
    plan: SbcPlan,
    model: CollapsedDensity,
    run: Run,
    truth: TrueValues,
    user: Array,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Rank true scales and locations among draws; give distribution functions at true means and new users."""
    points = np.concatenate(run.independent())
    laws = model.laws(points)
    drawn = points[rng.choice(len(points), size=plan.draws, replace=False)]
    beta = truth.beta.T.ravel()
    found: dict[str, float] = {}

    def add(name: str, values: Array) -> None:
        labels = [f"[{p},{e}]" for p, e in model.cells]
        if name in _BY_PARAMETER:
            labels = [f"[{p}]" for p in model.statistics.parameters]
        elif name.startswith("rho"):
            labels = [""]
        found.update(
            {name + label: float(value) for label, value in zip(labels, values, strict=True)}
        )

    def rank(name: str, draws: Array, true: Array) -> None:
        add(name, ((draws.reshape(plan.draws, -1) < true).sum(axis=0) + 0.5) / (plan.draws + 1))

    for name, (_, values) in model.scales(drawn).items():
        owner: Any = truth if hasattr(truth, name) else truth.hyper
        rank(name, values, np.ravel(np.transpose(getattr(owner, name))))
    rank("beta", model.draw(drawn, rng)[0], beta)
    add("mean", special.ndtr((beta - laws.mean) / laws.sd).mean(axis=0))
    add(
        "user",
        special.ndtr((user - laws.mean) / np.hypot(laws.sd, laws.population_sd)).mean(axis=0),
    )
    return found
