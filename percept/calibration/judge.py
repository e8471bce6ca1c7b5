"""One simulated study, refitted: how much of what each interval and boundary claims is true."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.curves import Boundary
from percept.errors import RefusalError, UsageError
from percept.haptics import Device
from percept.haptics.perceived import perceived_magnitude
from percept.inference.hierarchy.priors import Priors
from percept.scene import Scene
from percept.sessions import ReadOptions, Sessions
from percept.simulate.model import (
    PARAMETERS,
    Design,
    Hyperparameters,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    simulate,
)
from percept.study import Study
from percept.study.regions import displayable

Array = NDArray[np.float64]
Family = Literal["lognormal", "normal"]
# Users drawn per environment, whose curves a boundary of the next user is held against.
_USERS = 200
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(64)
#: Claims of a plan that judges each interval by itself.
EACH = "{parameter} in {environment}"
#: What tells the claims of one study apart: what is claimed, and of which interval or boundary.
LABELS = ["claim", "kind", "method", "family", "joint", "shape"]
#: Labels of a claim, and for which fraction of users and frequencies it was true.
_Held = tuple[tuple[str, ...], float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class CoveragePlan:
    """Studies to simulate, and how to analyse each."""

    references: tuple[tuple[float, ...], ...]  # Of `parameters`, in the environments tested
    environments: tuple[str, ...] = ()  # Their names; VE1, VE2, … where there are none
    subjects: int = 10  # Per study
    trials: tuple[tuple[int, ...], ...] | None = (
        None  # Of each subject in each environment; one where None
    )
    truth: Family = "lognormal"  # Distribution of the simulated users
    family: Family = "lognormal"  # Of the hierarchical model
    method: Literal["both", "classical", "bayesian"] = "both"  # Which methods are judged
    level: float = 0.99  # As `InferenceTable`
    share: float | None = None  # As `InferenceTable`
    confidence: float = 0.95  # As `InferenceTable`
    tolerance: float = 0.05  # Of the sampler
    values: dict[str, Any] | None = (
        None  # What the studies are drawn from, as `fitted_values` gives it
    )
    device: tuple[float, float] = (1.0, 5.0)  # kg and N·s/m
    period: float = 0.001  # Sampling period, s
    frequencies: tuple[float, float, int] = (0.1, 100.0, 11)  # From, to, rad/s, and how many
    seed: int = 1  # Of the whole
    model: dict[str, Any] = dataclasses.field(default_factory=dict)  # [model] of the analysis
    parameters: tuple[str, ...] = PARAMETERS  # One or two quantities
    quantities: dict[str, Any] = dataclasses.field(
        default_factory=dict
    )  # [quantities] of the analysis
    each: bool = (
        False  # Judge the next user's intervals only, in each environment and parameter by itself
    )

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
        # Kept studies were counted when a plan could hold an environment out.
        record = dataclasses.asdict(self) | {"held_out": None}
        if self.parameters == PARAMETERS:
            # Studies of stiffness and damping that are kept were counted before there were others.
            del record["parameters"], record["quantities"]
        return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()[:16]

    def true_values(self) -> TrueValues | None:
        """Return `values` as a record, None where they are drawn from the priors."""
        if self.values is None:
            return None
        hyper: dict[str, Any] = {
            name: np.array(value) if isinstance(value, (list, tuple)) else value
            for name, value in self.values["hyper"].items()
        }
        cells = {name: np.array(value) for name, value in self.values.items() if name != "hyper"}
        return TrueValues(hyper=Hyperparameters(**hyper), **cells)


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
        """Return what intervals of kind mean are about, by the family of the interval."""
        if self.family == "lognormal":
            return self.native(self.mean + (0.5 * self.sd**2 if family == "normal" else 0.0))
        if family == "normal":
            return self.native(self.mean)
        values = self.native(self.mean + self.sd * _NODES[:, None])
        kept = np.where(values > 0, _WEIGHTS[:, None], 0.0)
        logs = np.log(np.where(values > 0, values, 1.0))
        return np.exp((kept * logs).sum(axis=0) / kept.sum(axis=0))

    def users(self, count: int, rng: np.random.Generator) -> Array:
        """Draw users, (count, P)."""
        return self.native(
            rng.multivariate_normal(self.mean, self.covariance, count, method="eigh")
        )


def judge_study(plan: CoveragePlan, index: int) -> dict[str, Any]:
    """Simulate study number `index` of a plan, analyse it, and judge every claim: a row each in `judged`."""
    rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(index,)))
    study, populations = _simulated(plan, rng)

    def lost(claim: str) -> dict[str, Any]:
        return dict(
            zip((*LABELS, "held"), (claim, "", "bayesian", plan.family, "", "", 1.0), strict=True)
        )

    rows = []
    try:
        if study.fit is None and plan.method != "classical":
            rows.append(lost("refused"))
        elif study.fit is not None and not study.fit.run.gate.passed:
            rows.append(lost("withheld"))
    except RefusalError:
        rows.append(lost("refused"))
        if plan.method == "bayesian":
            return {"judged": rows}
        study = Study(study.sessions, study.scene.with_inference(method="classical"))
    users = dict(zip(study.environments, populations, strict=True))
    held: dict[tuple[str, ...], list[float]] = {}
    for labels, fraction in _claims(plan, study, users, rng):
        held.setdefault(labels, []).append(fraction)
    # Environments and parameters of one study are not independent: a study is one observation.
    rows += [
        {**dict(zip(LABELS, labels, strict=True)), "held": float(np.mean(fractions))}
        for labels, fractions in held.items()
    ]
    return {"judged": rows}


def _claims(
    plan: CoveragePlan, study: Study, users: dict[str, Population], rng: np.random.Generator
) -> Iterator[_Held]:
    """Yield each claim of a study, and how far it was true."""
    intervals = study.intervals
    if plan.each:
        intervals = intervals.query(
            "joint == 'marginal' and (method == 'bayesian' or family == 'normal')"
        )
    for row in intervals.to_dict("records"):
        cell = {name: row[name] for name in ("environment", "parameter")}
        claim = EACH.format(**cell) if plan.each else "interval"
        yield _labels(claim, row), interval_held(row, users[row["environment"]])
    if plan.parameters == PARAMETERS and not plan.each:
        yield from _held_boundaries(study.boundaries, users, study, rng)


def _simulated(plan: CoveragePlan, rng: np.random.Generator) -> tuple[Study, list[Population]]:
    """Simulate one study, and give the users of each of its environments."""
    references = np.array(plan.references)
    trials = (
        np.ones((plan.subjects, len(references)), int)
        if plan.trials is None
        else np.array(plan.trials)
    )
    design = Design(references, trials, plan.parameters, plan.environments)
    truth = plan.true_values()
    if truth is None:
        truth = draw_environments(draw_hyperparameters(design, Priors(), rng), design, rng)
    table = simulate(truth, design, rng, family=plan.truth)
    lower, upper, points = plan.frequencies
    device = {"mass": plan.device[0], "damping": plan.device[1], "period": plan.period}
    described = (
        {"device": device} if plan.parameters == PARAMETERS else {"quantities": plan.quantities}
    )
    scene = Scene(
        **described,
        frequency={"lower": lower, "upper": upper, "points": points},
        model=plan.model,
        inference={
            "kinds": ["user"] if plan.each else ["mean", "user", "share"],
            "level": plan.level,
            "share": plan.level if plan.share is None else plan.share,
            "confidence": plan.confidence,
            "family": plan.family,
            "method": plan.method,
            "tolerance": plan.tolerance,
            "seed": int(rng.integers(1 << 31)),
        },
    )
    # Without repeats a user's value contains the trial noise.
    cov = truth.cov_u + truth.cov_w + (0.0 if design.repeated else truth.cov_e)
    populations = [
        Population(plan.truth, reference, beta, of_one, plan.parameters)
        for reference, beta, of_one in zip(references, truth.beta, cov, strict=True)
    ]
    # Declared units: a true median far from its reference is no slip of the unit.
    units = {
        f"{name}_{column}": {"name": f"{name}_{column}", "unit": scene.quantities[name].unit}
        for name in plan.parameters
        for column in ("ref", "adj")
        if scene.quantities[name].unit
    }
    options = ReadOptions(quantities=scene.quantities, columns=units)
    return (
        Study(Sessions.from_frame(table.drop(columns="source"), options=options), scene),
        populations,
    )


def _labels(claim: str, of: dict[Any, Any]) -> tuple[str, ...]:
    return claim, *(str(of.get(name, "")) for name in LABELS[1:])


def interval_held(row: dict[Any, Any], users: Population) -> float:
    """Return what share of users an interval of the next user holds; of other kinds whether it is right."""
    p, lower, upper = users.parameters.index(row["parameter"]), row["lower"], row["upper"]
    if row["kind"] == "mean":
        return float(lower <= users.average(row["family"])[p] <= upper)
    content = users.content(p, lower, upper)
    return content if row["kind"] == "user" else float(content >= row["share"])


def _held_boundaries(
    boundaries: Iterable[Boundary],
    populations: dict[str, Population],
    study: Study,
    rng: np.random.Generator,
) -> Iterator[_Held]:
    table = study.scene.device
    assert table is not None
    assert isinstance(study.device, Device)
    users = {
        environment: population.users(_USERS, rng)
        for environment, population in populations.items()
    }
    for boundary in boundaries:
        if boundary.kind == "share" or boundary.shape == "corner":
            continue
        points = users[boundary.environment]
        if boundary.kind == "mean":
            points = populations[boundary.environment].average(boundary.family)[None]
        points = displayable(points)
        curves = perceived_magnitude(
            boundary.omega[:, None], study.device, points[:, 0], points[:, 1], table.period
        )
        inside = (boundary.lower[:, None] <= curves) & (curves <= boundary.upper[:, None])
        yield _labels("boundary at an omega", vars(boundary)), float(inside.mean())
        yield _labels("boundary throughout", vars(boundary)), float(inside.all(axis=0).mean())
