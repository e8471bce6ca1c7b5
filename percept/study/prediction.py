"""Intervals and boundaries of an environment nobody tested."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Self

import numpy as np
import pandas as pd

from percept import haptics
from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.model.laws import Joint
from percept.inference.model.limits import NewLimits, limits_of
from percept.inference.model.predictions import new_environment, new_name
from percept.inference.record import Kind
from percept.results import Boundary, IntervalRow, Skipped
from percept.scene import InferenceTable
from percept.sessions.quantities import IMPEDANCE, Quantities, Quantity, is_impedance
from percept.study.basics import Array, Stream, generator
from percept.study.boundaries import BoundaryDrawing
from percept.study.fit import Fit, estimands_of, sampled
from percept.study.intervals import bayesian_row
from percept.study.regions import Law, LawKind, PosteriorPairs, posterior_law, regions_of
from percept.study.responses import ResponseScale, refuse_no_ratio

if TYPE_CHECKING:
    from percept.study.study import Study


# Spreads of the new environment per posterior draw: its spread is drawn from the trend.
_REPEATS = 4
_NO_LOGARITHM = "and environments are compared by the logarithm of their reference"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Prediction(NotebookRecord):
    """What the hierarchical model expects of an untested environment."""

    environment: str  #: Its name; with factors, the rows name its conditions too
    decades: dict[str, float]  #: log10 of each reference over the geometric mean of those tested
    #: Decades by which each reference lies above the tested range; negative below.
    beyond: dict[str, float]
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
        outside = []
        for name, decades in self.beyond.items():
            if decades:
                side = "above" if decades > 0 else "below"
                label = self.quantities[name].label
                outside.append(f"{label} lies {abs(decades):.2g} decades {side} the tested range")
        away = f"{self.nearest}, {self.distance:.2g} decades away"
        nearest = f"the nearest tested environment is {away}"
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
    asked = study.scene.inference
    references = _references(study, stiffness=stiffness, damping=damping, at=at)
    refuse_no_ratio(study.data.reference, study.sessions.quantities, why=_NO_LOGARITHM)
    fit = _passed_fit(study)
    place = _Place.of(study, fit, references.values)
    expected, fit, limits = _expect(study, fit, place.decades)
    scale = ResponseScale.of(references.values, asked.family)
    rows: list[IntervalRow] = []
    errors: list[float] = []
    for name, of_condition in expected.items():
        rows += _rows(fit, of_condition, name, scale, limits[name])
        for of_kind in limits[name].values():
            errors += of_kind.errors.tolist()
    boundaries: tuple[Boundary, ...] = ()
    skipped: tuple[Skipped, ...] = ()
    if study.setup is not None and is_impedance(study.data.parameters):
        laws: list[Law] = []
        if study.sessions.form != "summary":
            for name, of_condition in expected.items():
                laws += _laws(fit, of_condition, name, scale, asked)
        environment = haptics.Environment(
            stiffness=float(references.values[0]),
            damping=float(references.values[1]),
            mass=references.mass,
        )
        shown = dict.fromkeys(expected, environment)
        setup = dataclasses.replace(study.setup, references=shown)
        regions = regions_of(rows, laws, None, asked)
        drawing = BoundaryDrawing(setup, regions, laws, study.scene.frequency, asked.tolerance)
        boundaries = drawing.at(None, list(expected), asked.kinds)
        skipped = tuple(drawing.skipped)
    return Prediction(
        environment=new_name(""),
        decades=dict(zip(study.data.parameters, place.decades.tolist(), strict=True)),
        beyond=dict(zip(study.data.parameters, place.beyond.tolist(), strict=True)),
        nearest=place.nearest,
        distance=place.distance,
        intervals=pd.DataFrame(rows).assign(monte_carlo=errors),
        boundaries=boundaries,
        skipped=skipped,
        quantities=study.sessions.quantities,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _References:
    """What the new environment renders."""

    values: Array  # (P,) in the units of the study's quantities
    mass: float  # kg


def _references(
    study: Study, *, stiffness: float | None, damping: float | None, at: Mapping[str, float] | None
) -> _References:
    """Collect the references given; UsageError for those missing, not positive, or not analysed."""
    quantities = study.sessions.quantities
    given = dict(at or {})
    if stiffness is not None:
        given.setdefault("k", stiffness)
    if damping is not None:
        given.setdefault("b", damping)
    mass = 0.0
    if is_impedance(study.data.parameters) and "m" not in quantities:
        mass = _mass(study, given.pop("m", None))
    for name, value in given.items():
        if name not in study.data.parameters:
            known = {**IMPEDANCE, **quantities}.get(name)
            label = known.label if known else name
            message = f"the study does not analyse {label}."
            raise UsageError(message, key=name, value=value, hint="Leave it out.")
    values = [_positive(quantities[name], given.get(name)) for name in study.data.parameters]
    return _References(np.array(values), mass)


@dataclasses.dataclass(frozen=True, eq=False)
class _Place:
    """Where the new environment lies among those tested, in decades."""

    decades: Array  # (P,) over the geometric mean of those tested
    beyond: Array  # (P,) above the tested range; negative below, zero inside
    nearest: str
    distance: float

    @classmethod
    def of(cls, study: Study, fit: Fit, values: Array) -> Self:
        """Compare references (P,) with the references of the fit's environments."""
        reference = study.data.reference
        rows = []
        for parameter in study.data.parameters:
            rows.append([reference[parameter, environment] for environment in fit.environments])
        tested = np.log10(rows)
        log = np.log10(values)
        above = np.maximum(log - tested.max(axis=1), 0.0)
        below = np.minimum(log - tested.min(axis=1), 0.0)
        distances = np.hypot.reduce(tested - log[:, None], axis=0)
        nearest = distances.argmin()
        decades = log - tested.mean(axis=1)
        distance = float(distances[nearest])
        name = fit.environments[nearest]
        if study.sessions.factors is not None:
            name, _ = study.sessions.factors.cells[name]
        return cls(decades, above + below, name, distance)


@dataclasses.dataclass(frozen=True, eq=False)
class _NewLimits:
    """Limits of an interval on the response scale, per parameter."""

    lower: Array  # (P,)
    upper: Array  # (P,)
    errors: Array  # (P,) Monte Carlo errors of the worse limit, in half-widths

    @classmethod
    def of(cls, lower: Array, upper: Array, errors: Array) -> Self:
        """Take standard errors (2, P) of lower and upper limit."""
        half_width = 0.5 * (upper - lower)
        return cls(lower, upper, errors.max(axis=0) / half_width)


def _expect(
    study: Study, fit: Fit, decades: Array
) -> tuple[dict[str, Joint], Fit, dict[str, dict[Kind, _NewLimits]]]:
    """Work out the new environment's users and limits, with more draws where needed.

    Both stand by the environment's name in each condition.
    """
    asked = study.scene.inference
    expected = expected_users(fit, decades, asked)
    limits: dict[str, dict[Kind, _NewLimits]] = {}
    worst = 0.0
    for name, laws in expected.items():
        limits[name] = {}
        for kind in asked.kinds:
            of_kind = _limits(fit, laws, kind, asked)
            limits[name][kind] = of_kind
            worst = max(worst, float(of_kind.errors.max()))
    if worst <= asked.tolerance:
        return expected, fit, limits
    claims = estimands_of(fit.model, asked)
    target = NewLimits(claims, decades, _REPEATS, asked.seed, list(expected))
    run = sampled(fit.model, asked, target, progress=study.progress, store=study.store)
    if not run.gate.passed:
        return expected, fit, limits
    fit = dataclasses.replace(fit, run=run)
    # The run's own limits and errors rest on all draws that it kept.
    found = run.estimates
    for name in expected:
        places = [(parameter, name) for parameter in fit.parameters]
        for kind in asked.kinds:
            lower, upper = limits_of(found.names, found.value, kind, places)
            errors = limits_of(found.names, run.errors, kind, places)
            limits[name][kind] = _NewLimits.of(lower, upper, np.stack(errors))
    return expected_users(fit, decades, asked), fit, limits


def expected_users(fit: Fit, x: Array, asked: InferenceTable) -> dict[str, Joint]:
    """Work out what a fit expects of the users of a new environment, by its name in a condition."""
    rng = generator(asked.seed, Stream.NEW_ENVIRONMENT)
    laws = new_environment(fit.model, fit.points, x, repeats=_REPEATS, rng=rng)
    return {new_name(condition): own for condition, own in laws.items()}


def _passed_fit(study: Study) -> Fit:
    """Return the study's fit; RefusalError without one that passed."""
    fit = study.fit
    if fit is None:
        raise RefusalError(
            "the classical method has no model of environments nobody tested.",
            hint='Set method = "both" or "bayesian".',
        )
    if not fit.passed:
        raise RefusalError(f"the posterior is withheld: {fit.withheld}")
    return fit


def _mass(study: Study, given: float | None) -> float:
    """Mass of the new environment, kg: the given one, or that of all tested environments."""
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
    """Return a reference; UsageError unless it is there and positive."""
    which = f"the {quantity.label} of the new environment"
    positive = f"a positive number of {quantity.unit}".removesuffix(" of ")
    if value is None:
        hint = f"The study analyses it: give {positive}."
        raise UsageError(f"{which} is missing.", key=quantity.name, hint=hint)
    if not (np.isfinite(value) and value > 0):
        raise UsageError(f"{which} must be {positive}.", key=quantity.name, value=value)
    return float(value)


def _limits(fit: Fit, expected: Joint, kind: Kind, asked: InferenceTable) -> _NewLimits:
    """Work out the limits of a kind, with errors from means over batches of draws."""
    lower, upper, influence = estimands_of(fit.model, asked).of(kind, expected.moments())
    batch = fit.run.batches()
    # A draw's repeats belong together.
    repeats = influence.reshape(len(batch), -1, influence.shape[1])
    of_draws = repeats.mean(axis=1)
    means = []
    for number in np.unique(batch):
        means.append(of_draws[batch == number].mean(axis=0))
    errors = np.std(means, axis=0, ddof=1) / np.sqrt(len(means))
    return _NewLimits.of(lower, upper, errors.reshape(2, -1))


def _rows(
    fit: Fit,
    expected: Joint,
    name: str,
    scale: ResponseScale,
    limits: Mapping[Kind, _NewLimits],
) -> Iterator[IntervalRow]:
    """Yield a row for every kind and parameter."""
    n = int(fit.counts.max())
    centre = expected.mean[:, 0].mean(axis=0)
    for kind, of_kind in limits.items():
        with np.errstate(over="ignore", under="ignore"):
            values = scale.native(np.stack([of_kind.lower, of_kind.upper, centre]))
        for index, parameter in enumerate(fit.parameters):
            lower, upper, estimate = values[:, index].tolist()
            ends = (lower, upper, estimate)
            reference = float(scale.origin[index])
            cell = (parameter, name)
            yield bayesian_row(fit.data, kind, cell, ends, reference, n=n, repeats=fit.repeats)


def _laws(
    fit: Fit, expected: Joint, name: str, scale: ResponseScale, asked: InferenceTable
) -> Iterator[Law]:
    """Yield the laws of the average and the next user of the environment."""
    n = int(fit.counts.max())
    batch = np.repeat(fit.run.batches(), _REPEATS)
    centre = expected.mean[:, 0]
    location = expected.location[:, 0]
    # The average does not depend on the spread, which takes the repeats.
    mean = PosteriorPairs(centre[::_REPEATS], location[::_REPEATS], batch[::_REPEATS], n)
    user = PosteriorPairs(centre, location + expected.users[:, 0], batch, n)
    drawn: Mapping[LawKind, PosteriorPairs] = {"mean": mean, "user": user}
    for kind, pairs in drawn.items():
        if kind in asked.kinds:
            yield posterior_law(name, kind, pairs, scale, asked)
