"""Studies drawn from the prior: plain ones by percept's simulator, others written out plainly.

No contrast here comes from the model's own columns: every factor has two levels, whose contrast is
minus or plus one half, and an interaction's contrast is the product of those of its factors.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.covariates import with_covariates
from percept.inference.model.design import Cells, Factors, design_of
from percept.inference.model.linear_posterior import LinearPosterior
from percept.inference.model.priors import Priors
from percept.inference.model.statistics import apart_by_subject, from_trials
from percept.inference.model.trial_scatter import trial_scatter
from percept.simulate.model import (
    Design,
    draw_environments,
    draw_hyperparameters,
    draw_responses,
)

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.intp]

#: Narrower than the defaults, so that few draws of the prior are studies nobody would run.
PRIORS = Priors(
    tau_scale=0.2,
    sigma_u_scale=0.4,
    log_s_mean=np.log(0.15),
    log_s_sd=0.4,
    omega_scale=0.3,
    log_s_e_mean=np.log(0.15),
    log_s_e_sd=0.4,
    omega_e_scale=0.3,
    omega_s_scale=0.8,
)
# Stiffness in N/m and damping in N·s/m, from soft to stiff.
_REFERENCES = np.array([[10.0, 0.1], [1e3, 1.0], [1e4, 10.0], [2.5e4, 25.0], [5e4, 50.0]])
# Trials of eight subjects in four environments: two miss some, and one sees a single one.
_GAPS = np.ones((8, 4), dtype=np.int64)
_GAPS[[0, 2, 2, 5, 5, 5], [1, 0, 3, 1, 2, 3]] = 0
#: Plain studies. The order decides the seeds, as in `KINDS`.
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
# Where the priors of plain studies are not the defaults. A twentieth of the scatter between trials:
# the data can hardly tell the scatter between subjects from none.
_WEAK = {"weak scatter": Priors(log_s_mean=math.log(0.005))}
GROUP = "group"
ENVIRONMENTS = ("VE1", "VE2")
#: Decades of their references above the geometric mean.
DECADES = np.array([-0.5, 0.5])


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of study. Its factors have two levels each; a subject has one of those of `group`."""

    factors: tuple[str, ...] = ()
    terms: tuple[str, ...] = ()
    subjects: int = 6
    trials: tuple[int, int] = (1, 1)  # Fewest and most of a subject in a cell
    missing: int = 0  # Cells of subjects that have no trials
    covariate: bool = False  # Whether bias follows a covariate of the trials
    own_trial_sds: bool = False
    spread: tuple[str, ...] = ()  # Factors whose levels differ in the spread of subjects' effects
    parameters: tuple[str, ...] = ("k",)


KINDS = {
    "two factors with interaction": Kind(
        factors=("hand", "load"), terms=("hand", "load", "hand:load"), spread=("hand",)
    ),
    "factor and group": Kind(
        factors=("hand", GROUP), terms=("hand", GROUP, "hand:group"), subjects=8, trials=(2, 2)
    ),
    "covariate, missing cells": Kind(
        factors=("hand",),
        terms=("hand",),
        trials=(1, 3),
        missing=3,
        covariate=True,
        parameters=("k", "b"),
    ),
    "subjects' own trial SDs": Kind(
        factors=("hand",), terms=("hand",), trials=(4, 4), own_trial_sds=True
    ),
    "subjects' own trial SDs, no factor": Kind(trials=(6, 6), own_trial_sds=True),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Drawn:
    """A study, what it was drawn from, and one more user."""

    kind: Kind
    environment: Indices  # (C,)
    level: dict[str, Indices]  # (C,) by factor
    contrast: dict[str, Array]  # (C,) by term
    environments: tuple[str, ...]
    x: Array  # (P, C) decades of the references above their geometric mean
    priors: Priors
    response: Array  # (M, P)
    subject: Indices  # (M,)
    cell: Indices  # (M,)
    covariate: Array  # (M, 1) centred, or (M, 0)
    truth: dict[str, Array]  # Scales and correlations by the model's names
    beta: Array  # (P, C)
    slope: Array  # (P,) of the covariate
    user: Array  # (P, C) one more user


def draw_plain(name: str, rng: np.random.Generator) -> Drawn:
    """Draw the truth, and then the trials, of one of `DESIGNS`."""
    design = DESIGNS[name]
    priors = _WEAK.get(name, Priors())
    truth = draw_environments(draw_hyperparameters(design, priors, rng), design, rng)
    responses = draw_responses(truth, design, rng)
    roots = np.linalg.cholesky(truth.cov_u + truth.cov_w)
    user = truth.beta + np.einsum("jpq,jq->jp", roots, rng.standard_normal(truth.beta.shape))
    size = len(design.parameters)
    return Drawn(
        kind=Kind(subjects=len(design.subjects), parameters=design.parameters),
        environment=np.arange(len(design.environments)),
        level={},
        contrast={},
        environments=design.environments,
        x=design.decades.T,
        priors=priors,
        response=responses.y,
        subject=responses.subject,
        cell=responses.environment,
        covariate=np.zeros((len(responses.y), 0)),
        truth=vars(truth.hyper) | {"sigma": truth.sigma.T, "sigma_e": truth.sigma_e.T},
        beta=truth.beta.T,
        slope=np.zeros(size),
        user=user.T,
    )


class _Prior:
    """Draws of the prior, kept by the model's names."""

    def __init__(self, kind: Kind, rng: np.random.Generator) -> None:
        self.rng = rng
        self.size = len(kind.parameters)
        self.truth: dict[str, Array] = {}

    def half(self, name: str, scale: float) -> Array:
        """Draw a half-normal value of each quantity."""
        self.truth[name] = np.abs(self.rng.normal(0.0, scale, self.size))
        return self.truth[name]

    def correlation(self, name: str) -> Array:
        """Draw a matrix (P, P) of unit diagonal."""
        if self.size == 1:
            return np.eye(1)
        shape = PRIORS.rho_shape
        rho = 2.0 * self.rng.beta(shape, shape) - 1.0
        self.truth[name] = np.array(rho)
        return np.array([[1.0, rho], [rho, 1.0]])

    def normals(self, correlation: Array, count: int) -> Array:
        """Draw correlated standard normals (count, P)."""
        return self.rng.multivariate_normal(np.zeros(self.size), correlation, count)

    def log_sds(self, suffix: str, x: Array, main_contrasts: Mapping[str, Array]) -> Array:
        """Draw log SDs (P, C) of one level of scatter."""
        mean = getattr(PRIORS, f"log_s{suffix}_mean")
        log_s = self.rng.normal(mean, getattr(PRIORS, f"log_s{suffix}_sd"), self.size)
        kappa = self.rng.normal(0.0, getattr(PRIORS, f"kappa{suffix}_sd"), self.size)
        self.truth[f"s{suffix}"] = np.exp(log_s)
        self.truth[f"kappa{suffix}"] = kappa
        log_sigma = log_s[:, None] + kappa[:, None] * x
        for factor, contrast in main_contrasts.items():
            psi = self.rng.normal(0.0, PRIORS.psi_sd, self.size)
            self.truth[f"psi{suffix}:{factor}"] = psi
            log_sigma = log_sigma + psi[:, None] * contrast
        omega = self.half(f"omega{suffix}", getattr(PRIORS, f"omega{suffix}_scale"))
        log_sigma = log_sigma + omega[:, None] * self.rng.standard_normal(log_sigma.shape)
        self.truth[f"sigma{suffix}"] = np.exp(log_sigma)
        return log_sigma


def draw_study(kind: Kind, rng: np.random.Generator) -> Drawn:
    """Draw the truth, and then the trials, of a study of a kind."""
    grid = np.array(list(itertools.product((0, 1), *((0, 1) for _ in kind.factors))))
    environment = grid[:, 0]
    level = {factor: grid[:, 1 + f] for f, factor in enumerate(kind.factors)}
    contrast = {}
    for term in kind.terms:
        halves = [level[factor] - 0.5 for factor in term.split(":")]
        contrast[term] = np.prod(halves, axis=0)
    x = DECADES[environment]
    prior = _Prior(kind, rng)
    beta = _locations(prior, x, environment, contrast)
    main = {factor: contrast[factor] for factor in kind.factors}
    log_sigma = prior.log_sds("", x, main)
    between = prior.correlation("rho_w")
    stretch = np.zeros_like(log_sigma)
    for factor in kind.spread:
        eta = rng.normal(0.0, PRIORS.psi_sd, prior.size)
        prior.truth[f"eta:{factor}"] = eta
        stretch = stretch + eta[:, None] * contrast[factor]
    # The last of these people is the user nobody has seen.
    people = kind.subjects + 1
    shared = _subject_effects(prior, people, contrast, len(grid)) * np.exp(stretch)
    cells = len(grid)
    own = prior.normals(between, people * cells).reshape(people, cells, prior.size)
    people_means = beta + shared + np.exp(log_sigma) * own.swapaxes(1, 2)  # (N + 1, P, C)
    subject, cell = _trials(kind, rng, level, cells)
    response = people_means[subject, :, cell]
    if kind.trials[1] > 1:
        log_sigma_e = prior.log_sds("_e", x, main)
        within = prior.correlation("rho_e")
        log_sd = log_sigma_e.T[cell]
        if kind.own_trial_sds:
            omega_s = prior.half("omega_s", PRIORS.omega_s_scale)
            phi = omega_s[:, None] * rng.standard_normal((prior.size, kind.subjects))
            prior.truth["phi"] = phi
            log_sd = log_sd + phi.T[subject]
        response = response + np.exp(log_sd) * prior.normals(within, len(cell))
    covariate = np.zeros((len(cell), 0))
    slope = np.zeros(prior.size)
    if kind.covariate:
        # It varies between trials and between subjects.
        values = rng.normal(0.0, 1.0, len(cell)) + rng.normal(0.0, 0.5, kind.subjects)[subject]
        covariate = (values - values.mean())[:, None]
        slope = rng.normal(0.0, PRIORS.covariate_sd, prior.size)
        response = response + covariate * slope
    return Drawn(
        kind=kind,
        environment=environment,
        level=level,
        contrast=contrast,
        environments=ENVIRONMENTS,
        x=np.tile(x, (prior.size, 1)),
        priors=PRIORS,
        response=response,
        subject=subject,
        cell=cell,
        covariate=covariate,
        truth=prior.truth,
        beta=beta,
        slope=slope,
        user=people_means[-1],
    )


def _locations(
    prior: _Prior, x: Array, environment: Indices, contrast: Mapping[str, Array]
) -> Array:
    """Draw means of all cells (P, C)."""
    rng = prior.rng
    alpha = rng.normal(0.0, PRIORS.alpha_sd, prior.size)
    gamma = rng.normal(0.0, PRIORS.gamma_sd, prior.size)
    tau = prior.half("tau", PRIORS.tau_scale)
    delta = tau[:, None] * rng.standard_normal((prior.size, len(ENVIRONMENTS)))
    beta = alpha[:, None] + gamma[:, None] * x + delta[:, environment]
    for term, values in contrast.items():
        coefficient = rng.normal(0.0, PRIORS.lambda_sd, prior.size)
        tau = prior.half(f"tau:{term}", PRIORS.tau_scale)
        zeta = tau[:, None] * rng.standard_normal((prior.size, len(ENVIRONMENTS)))
        beta = beta + values * (coefficient[:, None] + zeta[:, environment])
    return beta


def _subject_effects(
    prior: _Prior, people: int, contrast: Mapping[str, Array], cells: int
) -> Array:
    """Draw what each of some people adds to all cells, (people, P, C)."""
    columns = {"sigma_u": np.ones(cells)}
    for term, values in contrast.items():
        if GROUP not in term.split(":"):
            columns[f"sigma_v:{term}"] = values
    total = np.zeros((people, prior.size, cells))
    for name, values in columns.items():
        sd = prior.half(name, PRIORS.sigma_u_scale)
        correlation = prior.correlation(name.replace("sigma", "rho"))
        effects = sd * prior.normals(correlation, people)
        total = total + effects[:, :, None] * values
    return total


def _trials(
    kind: Kind, rng: np.random.Generator, level: Mapping[str, Indices], cells: int
) -> tuple[Indices, Indices]:
    """Draw subject and cell of every trial."""
    pairs = []
    for i, c in itertools.product(range(kind.subjects), range(cells)):
        if GROUP not in level or level[GROUP][c] == i % 2:
            pairs.append((i, c))
    gone = rng.choice(len(pairs), kind.missing, replace=False).tolist()
    kept = [pair for number, pair in enumerate(pairs) if number not in gone]
    fewest, most = kind.trials
    counts = rng.integers(fewest, most + 1, len(kept))
    subject, cell = np.repeat(kept, counts, axis=0).T
    return subject, cell


def model_of(
    drawn: Drawn,
    *,
    subjects_contrasts: bool = True,
    own_trial_sds: bool = True,
) -> LinearPosterior:
    """Return percept's model of a study: the right one, or one that leaves something out.

    Parameters
    ----------
    drawn : Drawn
        The study.
    subjects_contrasts : bool
        Whether subjects have contrasts of their own.
    own_trial_sds : bool
        Whether subjects have trial SDs of their own, where the study's subjects do.
    """
    kind = drawn.kind
    levels = dict.fromkeys(kind.factors, ("first", "second"))
    names = []
    for c, environment in enumerate(drawn.environment):
        own = [levels[factor][drawn.level[factor][c]] for factor in kind.factors]
        names.append(" ".join([drawn.environments[environment], *own]))
    statistics = from_trials(
        drawn.response,
        drawn.subject,
        drawn.cell,
        drawn.x,
        parameters=kind.parameters,
        environments=tuple(names),
        subjects=tuple(f"S{i + 1}" for i in range(kind.subjects)),
    )
    own_trial_sds = own_trial_sds and kind.own_trial_sds
    if own_trial_sds:
        statistics = apart_by_subject(statistics)
    trials = (drawn.response, drawn.subject, drawn.cell, drawn.covariate)
    scatter = trial_scatter(*trials, by_subject=False)
    covariates = None
    if kind.covariate:
        statistics, covariates = with_covariates(
            drawn.covariate, drawn.subject, drawn.cell, ("order",), statistics, scatter
        )
    if own_trial_sds:
        scatter = trial_scatter(*trials, by_subject=True)
    cells = Cells(tuple(names), drawn.environment, drawn.environments, drawn.x)
    factors = Factors(
        levels=levels,
        level=drawn.level,
        terms=tuple(tuple(term.split(":")) for term in kind.terms),
        between_subjects=frozenset({GROUP}.intersection(kind.factors)),
        spread=kind.spread,
    )
    design = design_of(cells, factors, drawn.priors)
    if not subjects_contrasts:
        design = dataclasses.replace(design, subject=design.subject[:1])
    return LinearPosterior(statistics, design, drawn.priors, covariates, scatter)
