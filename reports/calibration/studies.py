"""Studies drawn from the prior, written out plainly: nothing here comes from the model's code."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping

import numpy as np

from percept.inference.model.priors import Priors
from reports.studies import COVARIATE, Array, Indices, Observed

#: Narrower than the defaults, so that few draws of the prior are studies nobody would run.
NARROW = Priors(
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
GROUP = "group"
#: Of the references, from the softest to the stiffest.
DECADES = 3.0


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of study. Its factors have two levels each; a subject has one of those of `group`."""

    subjects: int = 6
    environments: int = 2
    trials: tuple[int, int] = (1, 1)  # Fewest and most of a subject in a cell
    factors: tuple[str, ...] = ()
    interaction: bool = False
    missing: int = 0  # Cells of subjects that have no trials
    covariate: bool = False  # Whether bias follows a covariate of the trials
    own_trial_sds: bool = False
    own_trends: bool = False
    spread: tuple[str, ...] = ()  # Factors whose levels differ in the spread of subjects' effects
    parameters: tuple[str, ...] = ("k", "b")
    priors: Priors = NARROW

    @property
    def terms(self) -> list[str]:
        """Factors, and the interaction of all."""
        return [*self.factors, *([":".join(self.factors)] if self.interaction else [])]


_ONE = ("k",)
#: A twentieth of the scatter between trials: the data can hardly tell the scatter between subjects
#: from none.
_WEAK = Priors(log_s_mean=math.log(0.005))
#: The order decides the seeds.
KINDS = {
    "balanced": Kind(10, 5, priors=Priors()),
    "trials": Kind(8, 3, (3, 3), priors=Priors()),
    "missing cells": Kind(8, 4, missing=6, priors=Priors()),
    "one parameter": Kind(8, 4, parameters=_ONE, priors=Priors()),
    "one environment": Kind(8, 1, priors=Priors()),
    "three subjects": Kind(3, 3, priors=Priors()),
    "weak scatter": Kind(10, 5, (3, 3), priors=_WEAK),
    "thirty environments": Kind(8, 30, priors=Priors()),
    "two factors with interaction": Kind(
        factors=("hand", "load"), interaction=True, spread=("hand",), parameters=_ONE
    ),
    "factor and group": Kind(8, 2, (2, 2), ("hand", GROUP), interaction=True, parameters=_ONE),
    "covariate, missing cells": Kind(trials=(1, 3), factors=("hand",), missing=3, covariate=True),
    "subjects' own trial SDs": Kind(
        trials=(4, 4), factors=("hand",), own_trial_sds=True, parameters=_ONE
    ),
    "subjects' own trial SDs, no factor": Kind(trials=(6, 6), own_trial_sds=True, parameters=_ONE),
    "subjects' own trends": Kind(10, 5, own_trends=True, priors=Priors()),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Drawn:
    """A study, what it was drawn from, and one more user."""

    observed: Observed
    truth: dict[str, Array]  # Scales and correlations by the model's names
    beta: Array  # (P, C)
    slope: Array  # (P,) of the covariate
    user: Array  # (P, C) one more user


class _Prior:
    """Draws of the prior, kept by the model's names; what one environment cannot show is zero."""

    def __init__(self, kind: Kind, x: Array, rng: np.random.Generator) -> None:
        self.kind = kind
        self.priors = kind.priors
        self.x = x  # (P, C)
        self.rng = rng
        self.size = len(kind.parameters)
        self.several = float(kind.environments > 1)
        self.truth: dict[str, Array] = {}

    def normal(self, sd: float, mean: float = 0.0) -> Array:
        """Draw a value of each quantity."""
        return self.rng.normal(mean, sd, self.size)

    def half(self, name: str, scale: float) -> Array:
        """Draw a half-normal value of each quantity."""
        self.truth[name] = self.several * np.abs(self.normal(scale))
        return self.truth[name]

    def correlation(self, name: str) -> Array:
        """Draw a matrix (P, P) of unit diagonal."""
        if self.size == 1:
            return np.eye(1)
        shape = self.priors.rho_shape
        rho = 2.0 * self.rng.beta(shape, shape) - 1.0
        self.truth[name] = np.array(rho)
        return np.array([[1.0, rho], [rho, 1.0]])

    def normals(self, correlation: Array, count: int) -> Array:
        """Draw correlated standard normals (count, P)."""
        return self.rng.multivariate_normal(np.zeros(self.size), correlation, count)

    def log_sds(self, suffix: str, contrast: Mapping[str, Array]) -> Array:
        """Draw log SDs (P, C) of one level of scatter."""
        prior = vars(self.priors)
        log_s = self.normal(prior[f"log_s{suffix}_sd"], prior[f"log_s{suffix}_mean"])
        kappa = self.several * self.normal(prior[f"kappa{suffix}_sd"])
        self.truth[f"s{suffix}"] = np.exp(log_s)
        self.truth[f"kappa{suffix}"] = kappa
        log_sigma = log_s[:, None] + kappa[:, None] * self.x
        for factor in self.kind.factors:
            psi = self.normal(self.priors.psi_sd)
            self.truth[f"psi{suffix}:{factor}"] = psi
            log_sigma = log_sigma + psi[:, None] * contrast[factor]
        omega = self.half(f"omega{suffix}", prior[f"omega{suffix}_scale"])
        log_sigma = log_sigma + omega[:, None] * self.rng.standard_normal(log_sigma.shape)
        self.truth[f"sigma{suffix}"] = np.exp(log_sigma)
        return log_sigma

    def deviations(self, name: str, environment: Indices) -> Array:
        """Draw what each environment has of its own, at the cells (P, C)."""
        tau = self.half(name, self.priors.tau_scale)
        own = self.rng.standard_normal((self.size, self.kind.environments))
        return (tau[:, None] * own)[:, environment]

    def locations(self, environment: Indices, contrast: Mapping[str, Array]) -> Array:
        """Draw means of all cells (P, C)."""
        alpha = self.normal(self.priors.alpha_sd)
        gamma = self.several * self.normal(self.priors.gamma_sd)
        beta = alpha[:, None] + gamma[:, None] * self.x + self.deviations("tau", environment)
        for term, values in contrast.items():
            coefficient = self.normal(self.priors.lambda_sd)[:, None]
            beta = beta + values * (coefficient + self.deviations(f"tau:{term}", environment))
        return beta

    def subject_effects(self, people: int, own: Mapping[str, Array]) -> Array:
        """Draw what each of some people adds to all cells, (people, P, C)."""
        columns = {"sigma_u": np.ones(self.x.shape[1])}
        columns |= {f"sigma_v:{term}": values for term, values in own.items()}
        total = np.zeros((people, *self.x.shape))
        for name, values in columns.items():
            is_trend = name == "sigma_v:trend"
            scale = self.priors.sigma_trend_scale if is_trend else self.priors.sigma_u_scale
            sd = self.half(name, scale)
            correlation = self.correlation(name.replace("sigma", "rho"))
            effects = sd * self.normals(correlation, people)
            total = total + effects[:, :, None] * values
        return total


def draw_study(kind: Kind, rng: np.random.Generator) -> Drawn:
    """Draw the truth, and then the trials, of a study of a kind."""
    grid = itertools.product(range(kind.environments), *((-0.5, 0.5) for _ in kind.factors))
    environments, *levels = np.array(list(grid)).T
    environment = environments.astype(np.intp)
    level = dict(zip(kind.factors, levels, strict=True))
    contrast = {}
    for term in kind.terms:
        contrast[term] = np.prod([level[factor] for factor in term.split(":")], axis=0)
    centred = np.linspace(-0.5, 0.5, kind.environments) if kind.environments > 1 else np.zeros(1)
    x = np.tile(DECADES * centred[environment], (len(kind.parameters), 1))
    groups = tuple({GROUP}.intersection(kind.factors))
    subject, cell = _trials(kind, rng, contrast, len(environment))
    observed = Observed(
        kind.parameters,
        np.zeros((len(cell), len(kind.parameters))),
        subject,
        cell,
        environment,
        x,
        kind.priors,
        contrast,
        groups,
        kind.spread,
        own_trial_sds=kind.own_trial_sds,
        own_trends=kind.own_trends,
    )
    prior = _Prior(kind, x, rng)
    beta = prior.locations(environment, contrast)
    log_sigma = prior.log_sds("", contrast)
    stretch = np.zeros_like(log_sigma)
    for factor in kind.spread:
        eta = prior.normal(kind.priors.psi_sd)
        prior.truth[f"eta:{factor}"] = eta
        stretch = stretch + eta[:, None] * contrast[factor]
    # The last of these people is the user nobody has seen.
    people = kind.subjects + 1
    of_subjects = observed.own | ({"trend": x} if kind.own_trends else {})
    shared = prior.subject_effects(people, of_subjects) * np.exp(stretch)
    own = prior.normals(prior.correlation("rho_w"), people * len(environment))
    own = own.reshape(people, len(environment), prior.size).swapaxes(1, 2)
    means = beta + shared + np.exp(log_sigma) * own  # (N + 1, P, C)
    response = means[subject, :, cell]
    if kind.trials[1] > 1:
        log_sd = prior.log_sds("_e", contrast).T[cell]
        if kind.own_trial_sds:
            omega_s = prior.half("omega_s", kind.priors.omega_s_scale)
            phi = omega_s[:, None] * rng.standard_normal((prior.size, kind.subjects))
            prior.truth["phi"] = phi
            log_sd = log_sd + phi.T[subject]
        noise = prior.normals(prior.correlation("rho_e"), len(cell))
        response = response + np.exp(log_sd) * noise
    covariate = None
    slope = np.zeros(prior.size)
    if kind.covariate:
        # It varies within subjects, and each has a slope of their own.
        values = rng.normal(0.0, 1.0, len(cell))
        covariate = values - (np.bincount(subject, values) / np.bincount(subject))[subject]
        slope = prior.normal(kind.priors.covariate_sd)
        own_sd = prior.half(f"sigma_v:{COVARIATE}", kind.priors.sigma_u_scale)
        correlation = prior.correlation(f"rho_v:{COVARIATE}")
        own_slopes = own_sd * prior.normals(correlation, kind.subjects)
        response = response + covariate[:, None] * (slope + own_slopes[subject])
    observed = dataclasses.replace(observed, response=response, covariate=covariate)
    return Drawn(observed, prior.truth, beta, slope, means[-1])


def _trials(
    kind: Kind, rng: np.random.Generator, contrast: Mapping[str, Array], cells: int
) -> tuple[Indices, Indices]:
    """Draw subject and cell of every trial."""
    pairs = []
    for i, c in itertools.product(range(kind.subjects), range(cells)):
        if GROUP not in contrast or (contrast[GROUP][c] > 0) == i % 2:
            pairs.append((i, c))
    gone = rng.choice(len(pairs), kind.missing, replace=False).tolist()
    kept = [pair for number, pair in enumerate(pairs) if number not in gone]
    fewest, most = kind.trials
    counts = rng.integers(fewest, most + 1, len(kept))
    subject, cell = np.repeat(kept, counts, axis=0).T
    return subject, cell
