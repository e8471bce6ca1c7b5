"""One simulated study, refitted: how much of what each interval and boundary claims is true."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError, UsageError
from percept.haptics import Loop
from percept.haptics.perceived import perceived_magnitude
from percept.inference.model.priors import Priors
from percept.scene import InferenceTable, Scene
from percept.sessions import ReadError, Sessions
from percept.simulate import (
    PARAMETERS,
    Design,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    simulate,
)
from percept.study import Study
from percept.study.regions import displayable

Array = NDArray[np.float64]
Family = Literal["lognormal", "normal"]
Method = Literal["both", "classical", "bayesian"]
# Users drawn per environment, whose curves a boundary of the next user is held against.
_USERS = 200
# Gauss-Hermite nodes: enough for the mean logarithm of normal users to four digits.
_NODE_COUNT = 64
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(_NODE_COUNT)


class Labels(NamedTuple):
    """Labels of a claim: what is claimed, and of which interval or boundary."""

    claim: str
    kind: str = ""
    method: str = ""
    family: str = ""
    joint: str = ""
    shape: str = ""


#: By the claims of one study: the fraction of users, frequencies, environments and parameters that
#: each is true for.
Held: TypeAlias = dict[Labels, float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class CoveragePlan:
    """Studies to simulate, and how to analyse each."""

    design: Design
    scene: Scene  # Of the analysis; its seed serves the whole plan
    users_family: Family = "lognormal"  # Distribution of the simulated users
    values: TrueValues | None = None  # What the studies are drawn from; the priors where None

    def __post_init__(self) -> None:
        subjects, environments = self.design.trials.shape
        if environments < 2 and self.values is None:
            raise UsageError(
                "a coverage study needs at least two environments.", value=environments
            )
        if subjects < 2:
            raise UsageError("a coverage study needs at least two subjects.", value=subjects)

    @property
    def asked(self) -> InferenceTable:
        """What the analysis asks for."""
        return self.scene.inference


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


def judge_study(plan: CoveragePlan, index: int) -> Held:
    """Simulate study number `index` of a plan, analyse it, and judge every claim.

    Parameters
    ----------
    plan : CoveragePlan
        The plan.
    index : int
        Number of the study, from zero: its seed.

    Returns
    -------
    Held
        One per kind of claim, averaged over environments and parameters. "withheld" or "refused"
        comes first where a method gives nothing.
    """
    asked = plan.asked
    rng = np.random.default_rng(np.random.SeedSequence(asked.seed, spawn_key=(index,)))
    design = plan.design
    values = plan.values
    if values is None:
        hyper = draw_hyperparameters(design, Priors(), rng)
        values = draw_environments(hyper, design, rng)
    methods = ("classical", "bayesian") if asked.method == "both" else (asked.method,)
    refused = {method: Labels("refused", method=method, family=asked.family) for method in methods}
    try:
        study = _simulated_study(values, design, rng, plan.scene, plan.users_family)
    except (ReadError, RefusalError):
        # A prior allows users who differ by hundreds of decades. No file may hold such values.
        return dict.fromkeys(refused.values(), 1.0)
    judged: Held = {}
    if "bayesian" in methods:
        try:
            fit = study.fit
        except RefusalError:
            fit = None
        if fit is None:
            judged[refused["bayesian"]] = 1.0
            if asked.method == "bayesian":
                return judged
            study = Study(study.sessions, study.scene.with_inference(method="classical"))
        elif not fit.passed:
            judged[Labels("withheld", method="bayesian", family=asked.family)] = 1.0
    held: dict[Labels, list[float]] = {}
    populations = _populations(plan, values)
    rows: Iterator[Any] = iter(study.intervals.itertuples(index=False))
    for row in rows:
        labels = Labels("interval", row.kind, row.method, row.family, row.joint)
        held.setdefault(labels, []).append(interval_held(row, populations[row.environment]))
    for labels, value in _boundary_claims(study, populations, rng):
        held.setdefault(labels, []).append(value)
    # Environments and parameters of one study are not independent: a study is one observation.
    return judged | {labels: float(np.mean(values)) for labels, values in held.items()}


def _simulated_study(
    values: TrueValues, design: Design, rng: np.random.Generator, scene: Scene, family: Family
) -> Study:
    """Simulate the sessions of a study, and put them under a scene with a seed of their own."""
    table = simulate(values, design, rng, family=family).drop(columns="source")
    columns = {}
    # With declared units a median far from its reference is no slip of units.
    for parameter in design.parameters:
        unit = scene.quantities[parameter].unit
        for name in (f"{parameter}_ref", f"{parameter}_adj"):
            if unit:
                columns[name] = {"name": name, "unit": unit}
    reading = Scene(quantities=scene.quantities, columns=columns)
    scene = scene.with_inference(seed=int(rng.integers(1 << 31)))
    return Study(Sessions.from_frame(table, scene=reading), scene)


def _populations(plan: CoveragePlan, values: TrueValues) -> dict[str, Population]:
    """Return the users of each environment."""
    design = plan.design
    covariances = values.cov_users(design.decades)
    if not design.repeated:
        # Without repeats a user's value contains the trial noise.
        covariances = covariances + values.cov_e
    populations = {}
    for j, environment in enumerate(design.environments):
        populations[environment] = Population(
            plan.users_family,
            design.references[j],
            values.beta[j],
            covariances[j],
            design.parameters,
        )
    return populations


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
) -> Iterator[tuple[Labels, float]]:
    """Judge each boundary by the curves of its users, at single frequencies and throughout."""
    device = study.device
    table = study.scene.device
    if device is None or table is None:
        return
    loop = Loop(device, table.period)
    drawn = {name: population.users(_USERS, rng) for name, population in populations.items()}
    for boundary in study.boundaries:
        # No boundary of a share is about single users, and a corner curve states no level.
        if boundary.kind == "share" or boundary.shape == "corner":
            continue
        users = drawn[boundary.environment]
        if boundary.kind == "mean":
            users = populations[boundary.environment].average(boundary.family)[None]
        users = displayable(users)
        curves = perceived_magnitude(loop, boundary.omega[:, None], users[:, 0], users[:, 1])
        inside = (boundary.lower[:, None] <= curves) & (curves <= boundary.upper[:, None])
        for claim, held in (
            ("boundary at an omega", inside),
            ("boundary throughout", inside.all(axis=0)),
        ):
            labels = Labels(
                claim,
                boundary.kind,
                boundary.method,
                boundary.family,
                boundary.joint,
                boundary.shape,
            )
            yield labels, float(held.mean())
