"""One simulated study, refitted: how much of what each interval and boundary claims is true."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from percept.calibration.studies import Line, plan_digest
from percept.errors import RefusalError, UsageError
from percept.haptics import Device
from percept.haptics.perceived import perceived_magnitude
from percept.inference.hierarchy.priors import Priors
from percept.results import Boundary
from percept.scene import Scene
from percept.sessions import ReadOptions, Sessions
from percept.sessions.quantities import is_impedance
from percept.simulate.model import (
    PARAMETERS,
    Design,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    simulate,
)
from percept.study import Study
from percept.study.regions import displayable

__all__ = [
    "Claim",
    "CoveragePlan",
    "Labels",
    "Population",
    "claim_of_cell",
    "interval_held",
    "judge_study",
    "judged_line",
]

Array = NDArray[np.float64]
Family = Literal["lognormal", "normal"]
Method = Literal["both", "classical", "bayesian"]
# Users drawn per environment, whose curves a boundary of the next user is held against.
_USERS = 200
# Gauss-Hermite nodes: enough for the mean logarithm of normal users to four digits.
_NODE_COUNT = 64
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(_NODE_COUNT)


class Labels(NamedTuple):
    """What tells the claims of a study apart: what is claimed, of which interval or boundary."""

    claim: str
    kind: str = ""
    method: str = ""
    family: str = ""
    joint: str = ""
    shape: str = ""


@dataclasses.dataclass(frozen=True)
class Claim:
    """What one study claims, and how far that is true."""

    labels: Labels
    held: float  # Fraction of users, frequencies, environments and parameters it is true for

    @classmethod
    def from_line(cls, judged: Line) -> Claim:
        """Take a claim as `judged_line` gives it."""
        return cls(Labels(*(judged[name] for name in Labels._fields)), judged["held"])

    def to_line(self) -> Line:
        """Return the claim as JSON has it."""
        return {**self.labels._asdict(), "held": self.held}


@dataclasses.dataclass(frozen=True, kw_only=True)
class CoveragePlan:
    """Studies to simulate, and how to analyse each."""

    references: tuple[tuple[float, ...], ...]  # Of `parameters`, in the environments tested
    environments: tuple[str, ...] = ()  # Their names; VE1, VE2, … where there are none
    subjects: int = 10  # Per study
    # Of each subject in each environment; one where None.
    trials: tuple[tuple[int, ...], ...] | None = None
    users_family: Family = "lognormal"  # Distribution of the simulated users
    family: Family = "lognormal"  # Of the hierarchical model
    method: Method = "both"  # Which methods are judged
    level: float = 0.99  # As `InferenceTable`
    share: float | None = None  # As `InferenceTable`
    confidence: float = 0.95  # As `InferenceTable`
    tolerance: float = 0.05  # Of the sampler
    values: TrueValues | None = None  # What the studies are drawn from; the priors where None
    device: tuple[float, float] = (1.0, 5.0)  # kg and N·s/m
    period: float = 0.001  # Sampling period, s
    frequencies: tuple[float, float, int] = (0.1, 100.0, 11)  # From, to, rad/s, and how many
    seed: int = 1  # Of the whole
    model: dict[str, Any] = dataclasses.field(default_factory=dict)  # [model] of the analysis
    parameters: tuple[str, ...] = PARAMETERS  # One or two quantities
    # [quantities] of the analysis.
    quantities: dict[str, Any] = dataclasses.field(default_factory=dict)
    # Judge the next user's intervals only, in each environment and parameter by itself.
    each: bool = False

    def __post_init__(self) -> None:
        if len(self.references) < 2 and self.values is None:
            raise UsageError(
                "a coverage study needs at least two environments.", value=len(self.references)
            )
        if self.subjects < 2:
            raise UsageError("a coverage study needs at least two subjects.", value=self.subjects)

    @property
    def key(self) -> str:
        """A digest that tells results of different plans apart."""
        return plan_digest(self)

    @property
    def design(self) -> Design:
        """Who adjusts what, and how often."""
        references = np.array(self.references)
        trials = np.ones((self.subjects, len(references)), int)
        if self.trials is not None:
            trials = np.array(self.trials)
        return Design(references, trials, self.parameters, self.environments)

    @property
    def model_of_truth(self) -> dict[str, Any]:
        """Return [model] of the analysis: subjects have trial SDs of their own if they truly do."""
        if self.values is not None and np.any(self.values.hyper.omega_s):
            return self.model
        return {**self.model, "subjects_trial_sd": False}

    def scene(self, seed: int) -> Scene:
        """Return the scene that a simulated study is analysed under."""
        lower, upper, points = self.frequencies
        mass, damping = self.device
        described: dict[str, Any] = {"quantities": self.quantities}
        if is_impedance(self.parameters):
            described = {"device": {"mass": mass, "damping": damping, "period": self.period}}
        return Scene(
            **described,
            frequency={"lower": lower, "upper": upper, "points": points},
            model=self.model_of_truth,
            inference={
                "kinds": ["user"] if self.each else ["mean", "user", "share"],
                "level": self.level,
                "share": self.level if self.share is None else self.share,
                "confidence": self.confidence,
                "family": self.family,
                "method": self.method,
                "tolerance": self.tolerance,
                "seed": seed,
            },
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Population:
    """Users of one environment: points of equality, without trial noise."""

    family: Family  # Distribution of the users
    reference: Array  # (P,) In the units of the parameters
    mean: Array  # (P,) on the response scale
    covariance: Array  # (P, P) on the response scale
    parameters: tuple[str, ...] = PARAMETERS

    @property
    def sd(self) -> Array:
        """SD per parameter on the response scale."""
        return np.sqrt(np.diagonal(self.covariance))

    def native(self, response: Array) -> Array:
        """Responses (..., P) in the units of the parameters."""
        with np.errstate(over="ignore", under="ignore"):
            ratio = np.exp(response) if self.family == "lognormal" else 1.0 + response
            return self.reference * ratio

    def below(self, p: int, value: float) -> float:
        """Return the share of users whose parameter p lies below a value."""
        if self.family == "normal":
            response = value / self.reference[p] - 1.0
        elif value > 0:
            response = float(np.log(value / self.reference[p]))
        else:
            return 0.0
        return float(special.ndtr((response - self.mean[p]) / self.sd[p]))

    def content(self, p: int, lower: float, upper: float) -> float:
        """Return the share of users whose parameter p lies between limits."""
        return self.below(p, upper) - self.below(p, lower)

    def average(self, family: str) -> Array:
        """Return what intervals of kind mean are about, by the family of the interval, (P,)."""
        if family == "normal":
            # The mean of a lognormal is the exponential of its log mean plus half its variance.
            shift = 0.5 * self.sd**2 if self.family == "lognormal" else 0.0
            return self.native(self.mean + shift)
        if self.family == "lognormal":
            return self.native(self.mean)
        # The geometric mean of normal users, of those above zero.
        values = self.native(self.mean + self.sd * _NODES[:, None])
        positive = values > 0
        weights = np.where(positive, _WEIGHTS[:, None], 0.0)
        logs = np.log(np.where(positive, values, 1.0))
        return np.exp((weights * logs).sum(axis=0) / weights.sum(axis=0))

    def users(self, count: int, rng: np.random.Generator) -> Array:
        """Draw users, (count, P)."""
        return self.native(
            rng.multivariate_normal(self.mean, self.covariance, count, method="eigh")
        )


def judged_line(plan: CoveragePlan, index: int) -> Line:
    """Judge study number `index` of a plan; give its claims as a line of JSON has them.

    Parameters
    ----------
    plan : CoveragePlan
        The plan.
    index : int
        Number of the study, from zero.

    Returns
    -------
    Line
        Claims under ``judged``.
    """
    return {"judged": [claim.to_line() for claim in judge_study(plan, index)]}


def judge_study(plan: CoveragePlan, index: int) -> list[Claim]:
    """Simulate study number `index` of a plan, analyse it, and judge every claim.

    Parameters
    ----------
    plan : CoveragePlan
        The plan.
    index : int
        Number of the study, from zero: its seed.

    Returns
    -------
    list of Claim
        One per kind of claim, averaged over environments and parameters. "withheld" or "refused"
        comes first where the Bayesian method gives nothing.
    """
    rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(index,)))
    study, populations = _simulated(plan, rng)
    claims = []
    no_bayesian = "" if plan.method == "classical" else _why_no_bayesian(study)
    if no_bayesian:
        claims.append(Claim(Labels(no_bayesian, method="bayesian", family=plan.family), 1.0))
    if no_bayesian == "refused":
        if plan.method == "bayesian":
            return claims
        study = Study(study.sessions, study.scene.with_inference(method="classical"))
    held: dict[Labels, list[float]] = {}
    for claim in _claims(plan, study, populations, rng):
        held.setdefault(claim.labels, []).append(claim.held)
    # Environments and parameters of one study are not independent: a study is one observation.
    claims += [Claim(labels, float(np.mean(values))) for labels, values in held.items()]
    return claims


def _why_no_bayesian(study: Study) -> str:
    """Say whether Bayesian intervals are "refused" or "withheld"; nothing where they are given."""
    try:
        fit = study.parts.fit
    except RefusalError:
        return "refused"
    if fit is None:
        return "refused"
    return "" if fit.run.gate.passed else "withheld"


def _simulated(plan: CoveragePlan, rng: np.random.Generator) -> tuple[Study, dict[str, Population]]:
    """Simulate one study, and give the users of each of its environments."""
    design = plan.design
    values = plan.values
    if values is None:
        hyper = draw_hyperparameters(design, Priors(), rng)
        values = draw_environments(hyper, design, rng)
    table = simulate(values, design, rng, family=plan.users_family)
    scene = plan.scene(seed=int(rng.integers(1 << 31)))
    sessions = _as_sessions(table, scene, plan.parameters)
    covariances = values.cov_u + values.cov_w
    if not design.repeated:
        # Without repeats a user's value contains the trial noise.
        covariances = covariances + values.cov_e
    populations = {}
    for j, environment in enumerate(design.environments):
        populations[environment] = Population(
            plan.users_family, design.references[j], values.beta[j], covariances[j], plan.parameters
        )
    return Study(sessions, scene), populations


def _as_sessions(table: pd.DataFrame, scene: Scene, parameters: tuple[str, ...]) -> Sessions:
    """Read trials with declared units: a median far from its reference is no slip of units."""
    columns = {}
    for parameter in parameters:
        unit = scene.quantities[parameter].unit
        for name in (f"{parameter}_ref", f"{parameter}_adj"):
            if unit:
                columns[name] = {"name": name, "unit": unit}
    options = ReadOptions(quantities=scene.quantities, columns=columns)
    return Sessions.from_frame(table.drop(columns="source"), scene=options)


def claim_of_cell(parameter: str, environment: str) -> str:
    """Name the claim of a plan that judges each interval by itself."""
    return f"{parameter} in {environment}"


def _claims(
    plan: CoveragePlan,
    study: Study,
    populations: dict[str, Population],
    rng: np.random.Generator,
) -> Iterator[Claim]:
    """Yield each claim of a study, and how far it is true."""
    intervals = study.intervals
    if plan.each:
        intervals = intervals.query(
            "joint == 'marginal' and (method == 'bayesian' or family == 'normal')"
        )
    rows: Iterator[Any] = iter(intervals.itertuples(index=False))
    for row in rows:
        name = claim_of_cell(row.parameter, row.environment) if plan.each else "interval"
        labels = Labels(name, row.kind, row.method, row.family, row.joint)
        yield Claim(labels, interval_held(row, populations[row.environment]))
    if is_impedance(plan.parameters) and not plan.each:
        yield from _boundary_claims(study, populations, rng)


def interval_held(interval: Any, population: Population) -> float:
    """Judge an interval.

    Parameters
    ----------
    interval : object
        A row of `Study.intervals`, its columns as attributes.
    population : Population
        The users of its environment.

    Returns
    -------
    float
        For kind "user" the share of users inside; for other kinds 1 where it is right, else 0.
    """
    p = population.parameters.index(interval.parameter)
    if interval.kind == "mean":
        average = population.average(interval.family)[p]
        return float(interval.lower <= average <= interval.upper)
    content = population.content(p, interval.lower, interval.upper)
    return content if interval.kind == "user" else float(content >= interval.share)


def _boundary_claims(
    study: Study, populations: dict[str, Population], rng: np.random.Generator
) -> Iterator[Claim]:
    """Judge each boundary by the curves of its users, at single frequencies and throughout."""
    device = study.parts.device
    table = study.scene.device
    assert table is not None
    assert isinstance(device, Device)
    drawn = {name: population.users(_USERS, rng) for name, population in populations.items()}
    for boundary in study.boundaries:
        # No boundary of a share is about single users, and a corner curve states no level.
        if boundary.kind == "share" or boundary.shape == "corner":
            continue
        users = drawn[boundary.environment]
        if boundary.kind == "mean":
            users = populations[boundary.environment].average(boundary.family)[None]
        users = displayable(users)
        curves = perceived_magnitude(
            boundary.omega[:, None], device, users[:, 0], users[:, 1], table.period
        )
        inside = (boundary.lower[:, None] <= curves) & (curves <= boundary.upper[:, None])
        yield Claim(_boundary_labels("boundary at an omega", boundary), float(inside.mean()))
        throughout = inside.all(axis=0)
        yield Claim(_boundary_labels("boundary throughout", boundary), float(throughout.mean()))


def _boundary_labels(claim: str, boundary: Boundary) -> Labels:
    return Labels(
        claim,
        boundary.kind,
        boundary.method,
        boundary.family,
        boundary.joint,
        boundary.shape,
    )
