"""Simulation-based calibration (Talts et al. 2018): the posterior must hold what the prior says.

Studies are drawn from the prior and fitted. Over them, a true value's rank among independent
posterior draws is uniform, and so is the posterior distribution function at it, if the density, the
sampler and the conditionals are right. `uniformity` judges whether they are.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.hierarchy.interval_estimands import IntervalEstimands
from percept.inference.hierarchy.linear_posterior import LinearPosterior, plain_model
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import Statistics, from_trials
from percept.inference.sampling.gate import Run, Settings
from percept.inference.sampling.run import sample
from percept.provenance import Made
from percept.simulate.model import (
    Design,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    draw_responses,
)
from reports.calibration.uniformity import ERROR, Calibration, Plan, passed, ranks, verdict_table

Array = NDArray[np.float64]
# Stiffness in N/m and damping in N·s/m, from soft to stiff.
_REFERENCES = np.array([[10.0, 0.1], [1e3, 1.0], [1e4, 10.0], [2.5e4, 25.0], [5e4, 50.0]])
# Scales with one value per parameter; the others have one per parameter and environment.
_BY_PARAMETER = ("s", "s_e", "kappa", "kappa_e", "omega", "omega_e", "sigma_u", "tau")
PAGE = """# Simulation-based calibration

{total} studies were drawn from the prior and fitted. True scales, correlations and locations are\
 ranked among independent posterior draws; `mean` and `user` are the posterior distribution\
 functions at the true mean and at a new user. Each design's quantities are judged together by\
 simultaneous bands that a right density leaves with a probability of at most {error:g} %. Fits the\
 gate withheld are counted as failed and give no ranks. With few fits only large errors show.

{made}

{table}"""
# Trials of eight subjects in four environments: two miss some, and one sees a single one.
_GAPS = np.ones((8, 4), dtype=np.int64)
_GAPS[[0, 2, 2, 5, 5, 5], [1, 0, 3, 1, 2, 3]] = 0
#: The kinds of study that are calibrated. Their order decides their seeds.
DESIGNS: dict[str, Design] = {
    "balanced": Design.balanced(_REFERENCES, subjects=10),
    "trials": Design.balanced(_REFERENCES[:3], subjects=8, trials=3),
    "missing cells": Design(_REFERENCES[:4], _GAPS),
    "one parameter": Design.balanced(_REFERENCES[:4, :1], subjects=8, parameters=("k",)),
    "one environment": Design.balanced(_REFERENCES[2:3], subjects=8),
    "three subjects": Design.balanced(_REFERENCES[:3], subjects=3),
    "weak scatter": Design.balanced(_REFERENCES, subjects=10, trials=3),
    "thirty environments": Design.balanced(np.geomspace([10.0, 0.1], [5e4, 50.0], 30), subjects=8),
}
# Priors of truths and fits, where they are not the defaults. A twentieth of the scatter between
# trials: the data can hardly tell the scatter between subjects from none.
_PRIORS = {"weak scatter": Priors(log_s_mean=math.log(0.005))}


def place_study(
    plan: Plan,
    index: int,
    density: Callable[[Statistics, Priors], LinearPosterior] = plain_model,
) -> dict[str, float]:
    """Simulate study `index` of a plan, fit it and place its true values.

    Parameters
    ----------
    plan : Plan
        The design.
    index : int
        Number of the study, from zero: its seed.
    density : callable
        Makes the density of the scales; a wrong one must be caught.

    Returns
    -------
    dict of str to float
        A probability per quantity.

    Raises
    ------
    RefusalError
        The gate withholds the fit, or there is none.
    """
    design = DESIGNS[plan.kind]
    priors = _PRIORS.get(plan.kind, Priors())
    spawn_key = (list(DESIGNS).index(plan.kind), index)
    seeds = np.random.SeedSequence(plan.seed, spawn_key=spawn_key)
    truth_seed, run_seed, draw_seed = seeds.spawn(3)
    rng = np.random.default_rng(truth_seed)
    hyper = draw_hyperparameters(design, priors, rng)
    truth = draw_environments(hyper, design, rng)
    model = density(_statistics(truth, design, rng), priors)
    user = _one_more_user(truth, rng)
    estimands = IntervalEstimands(model, kinds=("mean", "user"))
    seed = int(run_seed.generate_state(1)[0])
    run = passed(sample(model, estimands, Settings(tolerance=plan.tolerance, seed=seed)))
    return places(plan, model, run, truth, user, np.random.default_rng(draw_seed))


def _statistics(truth: TrueValues, design: Design, rng: np.random.Generator) -> Statistics:
    """Draw the trials of a study and reduce them to what the density takes."""
    responses = draw_responses(truth, design, rng)
    return from_trials(
        responses.y,
        responses.subject,
        responses.environment,
        design.decades.T,
        parameters=design.parameters,
        environments=design.environments,
        subjects=design.subjects,
    )


def _one_more_user(truth: TrueValues, rng: np.random.Generator) -> Array:
    """Draw one more user in every environment, by parameter and environment, (P·J,)."""
    noise = rng.standard_normal(truth.beta.shape)
    roots = np.linalg.cholesky(truth.cov_u + truth.cov_w)
    user = truth.beta + np.einsum("jpq,jq->jp", roots, noise)
    return user.T.ravel()


def places(
    plan: Plan,
    model: LinearPosterior,
    run: Run,
    truth: TrueValues,
    user: Array,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Place true values in a posterior, each as a probability that is uniform over studies.

    Parameters
    ----------
    plan : Plan
        How many draws to rank among.
    model : LinearPosterior
        The model of the run.
    run : Run
        A run that passed the gate.
    truth : TrueValues
        What the study was drawn from.
    user : ndarray, shape (P·J,)
        One more user in every environment.
    rng : numpy.random.Generator
        Chooses draws, and draws locations.

    Returns
    -------
    dict of str to float
        Ranks of scales and locations; under ``mean[…]`` and ``user[…]`` the posterior distribution
        functions at the true mean and at the user.
    """
    points = np.concatenate(run.independent())
    chosen = rng.choice(len(points), size=plan.draws, replace=False)
    drawn = points[chosen]
    probabilities: dict[str, float] = {}

    def add(name: str, values: Array) -> None:
        labels = _labels(name, model)
        for label, value in zip(labels, values, strict=True):
            probabilities[name + label] = float(value)

    for name, (_, values) in model.scales(drawn).items():
        true = getattr(truth, name, None)
        if true is None:
            true = getattr(truth.hyper, name)
        add(name, ranks(values, np.ravel(np.transpose(true))))
    beta = truth.beta.T.ravel()
    add("beta", ranks(model.draw(drawn, rng)[0], beta))
    laws = model.laws(points)
    user_sd = np.hypot(laws.sd, laws.population_sd)
    below_mean = special.ndtr((beta - laws.mean) / laws.sd)
    below_user = special.ndtr((user - laws.mean) / user_sd)
    add("mean", below_mean.mean(axis=0))
    add("user", below_user.mean(axis=0))
    return probabilities


def _labels(name: str, model: LinearPosterior) -> list[str]:
    """Return what tells the values of one name apart."""
    if name.startswith("rho"):
        return [""]
    if name in _BY_PARAMETER:
        return [f"[{parameter}]" for parameter in model.statistics.parameters]
    return [f"[{parameter},{environment}]" for parameter, environment in model.cells]


def verdicts_json(calibrations: Sequence[Calibration]) -> str:
    """Write everything about the verdicts as JSON."""
    rows = []
    for calibration in calibrations:
        fields = dataclasses.asdict(calibration)
        rows.append({"design": fields.pop("kind"), **fields, "outside": calibration.outside})
    return json.dumps(rows, indent=1) + "\n"


def page(calibrations: Sequence[Calibration], made: Made) -> str:
    """Write the verdicts with how to read them."""
    total = sum(calibration.fits for calibration in calibrations)
    return PAGE.format(
        total=total,
        error=100 * ERROR,
        made=made.sentence,
        table=verdict_table("design", calibrations),
    )
