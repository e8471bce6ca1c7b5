"""Intervals and boundaries of an environment nobody tested."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
import pandas as pd

from percept import haptics
from percept.boundary.curves import Boundary
from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.hierarchy.new_environment import (
    NewEnvironment,
    NewEstimands,
    new_environment,
)
from percept.inference.record import Kind
from percept.scene import InferenceTable
from percept.sessions.quantities import IMPEDANCE, Quantities, Quantity, is_impedance
from percept.study.basics import Array, Skipped, Stream, generator
from percept.study.boundaries import BoundaryDrawing
from percept.study.fit import Fit, estimands_of, sampled
from percept.study.intervals import bayesian_row
from percept.study.regions import Law, LawKind, posterior_law, regions_of
from percept.study.responses import ResponseScale, refuse_no_ratio

if TYPE_CHECKING:
    from percept.study.study import Study

#: Name of the environment.
_NEW = "new"
# Spreads of the new environment per posterior draw.
_REPEATS = 4
#: Why a reference of zero cannot be predicted from, nor for.
_NO_PLACE = "and has no place on the scale that environments are compared on"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Prediction(NotebookRecord):
    """What the hierarchical model expects of an untested environment."""

    environment: str  #: Its name
    decades: dict[str, float]  #: log10 of each reference over the geometric mean of those tested
    beyond: dict[
        str, float
    ]  #: Decades by which each reference lies above the tested range; negative below
    nearest: str  #: The tested environment whose references are nearest
    distance: float  #: How far that is, decades
    #: As `percept.Study.intervals`, and `monte_carlo`, the error of the limits over the half-width.
    intervals: pd.DataFrame
    boundaries: tuple[Boundary, ...]  #: Of abs(Z_h); empty without a device
    skipped: tuple[Skipped, ...] = ()  #: Curves that are not drawn, and why
    quantities: Quantities = dataclasses.field(default_factory=lambda: IMPEDANCE, repr=False)

    @property
    def extrapolates(self) -> bool:
        """Whether a reference lies outside the tested range."""
        return any(self.beyond.values())

    @property
    def sentence(self) -> str:
        """How far the environment lies from what was tested."""
        outside = [
            f"{self.quantities[p].label} lies {abs(d):.2g} decades "
            f"{'above' if d > 0 else 'below'} the tested range"
            for p, d in self.beyond.items()
            if d
        ]
        nearest = (
            f"the nearest tested environment is {self.nearest}, {self.distance:.2g} decades away"
        )
        if outside:
            return f"Extrapolation: {' and '.join(outside)}; {nearest}."
        return f"Inside the tested range of each parameter; {nearest}."


def predict(
    study: Study,
    *,
    stiffness: float | None = None,
    damping: float | None = None,
    at: Mapping[str, float] | None = None,
) -> Prediction:
    """Predict intervals and boundaries of an untested environment.

    Parameters
    ----------
    study : Study
        With a passed Bayesian fit that pools environments.
    stiffness, damping : float
        Of the environment, N/m and N·s/m; each where the study analyses it.
    at : mapping of str to float, optional
        References by the name of their quantity, in its unit; "m" is the environment's mass, kg,
        where the tested ones differ in theirs.

    Returns
    -------
    Prediction

    Raises
    ------
    UsageError
        A reference that is missing, not positive, or of a parameter that the study does not
        analyse.
    RefusalError
        No passed Bayesian fit, a tested reference of zero, or one environment.
    """
    quantities, asked = study.sessions.quantities, study.scene.inference
    named = {"k": stiffness, "b": damping}
    given = {p: value for p, value in named.items() if value is not None} | dict(at or {})
    rendered = is_impedance(study.parameters) and "m" not in quantities
    mass = _mass(study, given.pop("m", None)) if rendered else 0.0
    for parameter in (p for p in given if p not in study.parameters):
        known = {**IMPEDANCE, **quantities}.get(parameter)
        raise UsageError(
            f"the study does not analyse {known.label if known else parameter}.",
            key=parameter,
            value=given[parameter],
            hint="Leave it out.",
        )
    reference = np.array([_positive(quantities[p], given.get(p)) for p in study.parameters])
    refuse_no_ratio(study.reference, quantities, why=_NO_PLACE)
    fit, log = _fit(study), np.log10(reference)
    tested = np.log10([[study.reference[p, e] for e in fit.environments] for p in study.parameters])
    x = log - tested.mean(axis=1)
    expected = expected_users(fit, x, asked)
    limits = {kind: _limits(fit, expected, kind, asked) for kind in asked.kinds}
    if max(float(one.errors.max()) for one in limits.values()) > asked.tolerance:
        # The fit's draws were enough for the environments tested: sample until they are for this
        # one.
        target = NewEstimands(estimands_of(fit.model, asked), x, _REPEATS, asked.seed)
        run = sampled(fit.model, asked, target, progress=study.progress, store=study.store)
        if run.gate.passed:
            fit = dataclasses.replace(fit, run=run)
            expected = expected_users(fit, x, asked)
            # The run's own limits and errors rest on all draws that it kept.
            ends, errors = (
                v.reshape(len(asked.kinds), 2, -1) for v in (run.estimates.value, run.errors)
            )
            limits = {
                k: _Limits.of(ends[i, 0], ends[i, 1], errors[i]) for i, k in enumerate(asked.kinds)
            }
    scale = ResponseScale.of(reference, asked.family)
    intervals = pd.DataFrame(_rows(fit, expected, scale, asked, limits))
    boundaries: tuple[Boundary, ...] = ()
    skipped: tuple[Skipped, ...] = ()
    if study.setup is not None and is_impedance(study.parameters):
        laws = [] if study.sessions.form == "summary" else list(_laws(fit, expected, scale, asked))
        environment = haptics.Environment(
            stiffness=float(reference[0]), damping=float(reference[1]), mass=mass
        )
        setup = dataclasses.replace(study.setup, references={_NEW: environment})
        regions = regions_of(intervals, laws, None, asked)
        drawing = BoundaryDrawing(setup, regions, laws, study.scene.frequency, asked.tolerance)
        boundaries = drawing.at(None, [_NEW], asked.kinds)
        skipped = tuple(drawing.skipped)
    beyond = np.maximum(log - tested.max(axis=1), 0.0) + np.minimum(log - tested.min(axis=1), 0.0)
    far = np.hypot.reduce(tested - log[:, None], axis=0)
    return Prediction(
        environment=_NEW,
        decades=dict(zip(study.parameters, x.tolist(), strict=True)),
        beyond=dict(zip(study.parameters, beyond.tolist(), strict=True)),
        nearest=fit.environments[int(far.argmin())],
        distance=float(far.min()),
        intervals=intervals,
        boundaries=boundaries,
        skipped=skipped,
        quantities=quantities,
    )


class _Limits(NamedTuple):
    """Limits of an interval on the response scale, per parameter."""

    lower: Array
    upper: Array
    errors: Array  # Monte Carlo errors of the worse limit, in half-widths

    @classmethod
    def of(cls, lower: Array, upper: Array, errors: Array) -> Self:
        """Take standard errors (2, P) of lower and upper limit."""
        return cls(lower, upper, errors.max(axis=0) / (0.5 * (upper - lower)))


def expected_users(fit: Fit, x: Array, asked: InferenceTable) -> NewEnvironment:
    """Work out what a fit expects of the users of a new environment."""
    rng = generator(asked.seed, Stream.NEW_ENVIRONMENT)
    return new_environment(fit.model, fit.points, x, repeats=_REPEATS, rng=rng)


def _fit(study: Study) -> Fit:
    if study.fit is None:
        raise RefusalError(
            "the classical method has no model of environments nobody tested.",
            hint='Set method = "both" or "bayesian".',
        )
    if not study.fit.passed:
        raise RefusalError(f"the posterior is withheld: {study.fit.withheld}")
    return study.fit


def _mass(study: Study, given: float | None) -> float:
    """Mass of the new environment, kg: the one given, or the one that all tested environments have."""
    tested = set(study.sessions.masses.values())
    if given is None and len(tested) > 1:
        masses = ", ".join(f"{mass:g}" for mass in sorted(tested))
        message = f"the mass of the new environment is missing; tested ones have {masses} kg."
        raise UsageError(message, key="m", hint='Give it: at={"m": …}, or --at m=….')
    mass = next(iter(tested)) if given is None else float(given)
    if not (np.isfinite(mass) and mass >= 0):
        raise UsageError("the mass of the new environment is 0 or more kg.", key="m", value=mass)
    return mass


def _positive(quantity: Quantity, value: float | None) -> float:
    which = f"the {quantity.label} of the new environment"
    positive = f"a positive number of {quantity.unit}".removesuffix(" of ")
    if value is None:
        hint = f"The study analyses it: give {positive}."
        raise UsageError(f"{which} is missing.", key=quantity.name, hint=hint)
    if not (np.isfinite(value) and value > 0):
        raise UsageError(f"{which} must be {positive}.", key=quantity.name, value=value)
    return float(value)


def _limits(fit: Fit, expected: NewEnvironment, kind: Kind, asked: InferenceTable) -> _Limits:
    """Work out the limits of a kind, with errors from means over batches of draws, each with its repeats."""
    limits = estimands_of(fit.model, asked).limits(kind, expected.laws)
    batch = fit.run.batches()
    influence = limits.influence
    own = influence.reshape(len(batch), -1, influence.shape[1]).mean(axis=1)
    means = np.stack([own[batch == number].mean(axis=0) for number in np.unique(batch)])
    errors = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    return _Limits.of(limits.lower, limits.upper, errors.reshape(2, -1))


def _rows(
    fit: Fit,
    expected: NewEnvironment,
    scale: ResponseScale,
    asked: InferenceTable,
    limits: Mapping[Kind, _Limits],
) -> Iterator[dict[str, Any]]:
    """Yield a row for every kind and parameter."""
    rest: dict[str, Any] = {
        "n": int(fit.counts.max()),
        "repeats": fit.repeats,
        "approximate": fit.approximate,
    }
    for kind, found in limits.items():
        with np.errstate(over="ignore", under="ignore"):
            ends = scale.native(
                np.stack([found.lower, found.upper, expected.laws.mean.mean(axis=0)])
            )
        for p, parameter in enumerate(fit.parameters):
            cell, unit = (parameter, _NEW), fit.quantities[parameter].unit
            low, high, centre = ends[:, p].tolist()
            row = bayesian_row(
                asked, kind, cell, (low, high, centre), float(scale.origin[p]), unit, **rest
            )
            yield row | {"monte_carlo": float(found.errors[p])}


def _laws(
    fit: Fit, expected: NewEnvironment, scale: ResponseScale, asked: InferenceTable
) -> Iterator[Law]:
    """Yield the laws of the average and the next user of the environment."""
    batch, n = np.repeat(fit.run.batches(), _REPEATS), int(fit.counts.max())
    every: Mapping[LawKind, int] = {"mean": _REPEATS, "user": 1}
    for kind, step in every.items():
        if kind in asked.kinds:
            # The average does not depend on the spread, which takes the repeats.
            covariance = expected.covariance + (expected.population if kind == "user" else 0.0)
            drawn = expected.mean[::step], covariance[::step], batch[::step]
            yield posterior_law(_NEW, kind, scale, *drawn, n, asked)
