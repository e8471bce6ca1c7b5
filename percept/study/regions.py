"""Regions and laws of (k, b) behind boundaries: of every method, kind and joint treatment."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from percept.boundary.law import BEYOND, PairLaw, confidence_law, mixture_law
from percept.errors import PerceptError, RefusalError
from percept.inference.record import Family, Kind, Method
from percept.inference.regions import EllipseRegion, ellipse_region
from percept.results import IntervalRow, Skipped
from percept.scene import InferenceTable
from percept.sessions.quantities import is_impedance
from percept.study.basics import FAMILIES, Array
from percept.study.data import Data

if TYPE_CHECKING:
    from percept.inference.model.gaussian import Joint
    from percept.study.fit import Fit
    from percept.study.responses import ResponseScale


#: A share of users has neither a law nor an ellipse.
LawKind = Literal["mean", "user"]
_LAW_KINDS: tuple[LawKind, ...] = ("mean", "user")
_Side = tuple[float, float]
# Subjects that a covariance of k and b needs.
_FEWEST_SUBJECTS = 3


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Claim:
    """What curves are drawn for, and whose they are."""

    environment: str
    kind: Kind
    method: Method
    family: Family
    level: float


def claim_fields(source: Claim | IntervalRow) -> dict[str, Any]:
    """Return what a region, a law or an interval is drawn for."""
    return {field.name: getattr(source, field.name) for field in dataclasses.fields(Claim)}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Region(Claim):
    """A rectangle or an ellipse of (k, b) that feels like an environment."""

    joint: str
    limits: tuple[_Side, _Side] | None = None  # Of stiffness and of damping, N/m and N·s/m
    ellipse: EllipseRegion | None = None  # None for a rectangle


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Law(Claim):
    """What a method says of the stiffness and damping of the average or the next user together."""

    pair: PairLaw
    ellipse: EllipseRegion | None  # None where the subjects' values give none

    @property
    def region(self) -> Region | None:
        """The ellipse as a region; None where it leaves the range of curves."""
        ellipse = self.ellipse
        if ellipse is None:
            return None
        reach = np.abs(ellipse.centre) + ellipse.radius * ellipse.sd
        if self.family == "lognormal" and reach.max() >= np.log(BEYOND):
            return None
        return Region(**claim_fields(self), joint=ellipse.joint, ellipse=ellipse)


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectPairs:
    """One stiffness and one damping of each of N subjects in an environment."""

    family: Family  # Of the scale that a subject's trials are averaged on
    environment: str
    k: Array  # (N,) N/m
    b: Array  # (N,) N·s/m


#: What curves are drawn for.
Drawn = TypeVar("Drawn", Region, SubjectPairs)


def displayable(values: Array) -> Array:
    """Bring draws and limits (N/m, N·s/m) into the range that impedances can be computed for.

    Where little is known a spread, and so a draw or a limit, may leave the range of doubles.
    """
    sizes = np.clip(np.abs(values), 1.0 / BEYOND, BEYOND)
    return np.copysign(sizes, values)


def of_family(claims: Iterable[Drawn], family: Family) -> list[Drawn]:
    """Return what is of a family; where an environment has nothing of it, what is of the other."""
    found = list(claims)
    with_family = {one.environment for one in found if one.family == family}
    return [one for one in found if one.family == family or one.environment not in with_family]


def rectangles(intervals: Sequence[IntervalRow]) -> Iterator[Region]:
    """Pair the intervals of stiffness and damping."""
    of_b = {_paired_by(row): row for row in intervals if row.parameter == "b"}
    for row in intervals:
        other = of_b.get(_paired_by(row))
        if row.parameter != "k" or other is None:
            continue
        yield Region(
            **claim_fields(row),
            joint=row.joint,
            limits=(_side(row.lower, row.upper), _side(other.lower, other.upper)),
        )


def _paired_by(row: IntervalRow) -> tuple[object, ...]:
    return (*claim_fields(row).values(), row.joint)


def _side(lower: float, upper: float) -> _Side:
    """Return one side of a rectangle, in the range that impedances can be computed for."""
    low, high = displayable(np.array([lower, upper], dtype=float)).tolist()
    return low, high


def _halved(probability: float) -> float:
    """Return the probability that leaves out half as much."""
    return 1.0 - 0.5 * (1.0 - probability)


def widened(fit: Fit, asked: InferenceTable, environments: Collection[str]) -> Iterator[Region]:
    """Yield posterior rectangles by Bonferroni: sides leave out half as much each."""
    from percept.inference.model.limits import Limits

    halved = Limits(
        fit.model,
        level=_halved(asked.level),
        share=_halved(asked.share),
        confidence=_halved(asked.confidence),
    )
    wanted = [name for name in fit.environments if name in environments]
    columns = np.transpose([fit.pair(name) for name in wanted]).ravel().tolist()
    moments = fit.model.moments(fit.points, fit.model.cell_rows[columns])
    for kind in asked.kinds:
        lower, upper, _ = halved.of(kind, moments)
        ends = fit.scale.at(columns).native(np.stack([lower, upper]))
        for environment, (k, b) in zip(wanted, ends.reshape(2, 2, -1).T, strict=True):
            yield Region(
                environment=environment,
                kind=kind,
                method="bayesian",
                family=asked.family,
                level=asked.level,
                joint="bonferroni",
                limits=(_side(*k), _side(*b)),
            )


def subject_pairs(data: Data) -> Iterator[SubjectPairs | Skipped]:
    """Yield what classical ellipses and laws come from, and those there are none of."""
    published = data.sessions.form == "summary"
    if published:
        yield Skipped("subject effects and k-b correlation", "published limits do not hold them")
    if not data.is_impedance:
        return
    if published:
        why = "published limits hold no correlation of k and b"
        yield Skipped("ellipses and curves through draws", why)
        return
    if data.asked.method != "classical" and data.scene.model.pooling == "none":
        why = "cells without pooling hold no correlation of k and b"
        yield Skipped("Bayesian ellipses and curves through draws", why)
    if data.asked.method == "bayesian":
        return
    for family, environment in itertools.product(FAMILIES, data.environments):
        try:
            k, b = data.means(environment, "k", "b", family=family).T
        except PerceptError:
            # No trial has both, or a value has no logarithm.
            continue
        what = f"classical ellipses and curves through draws of {environment}"
        if len(k) < _FEWEST_SUBJECTS:
            needed = f"they need {_FEWEST_SUBJECTS} subjects with both parameters"
            yield Skipped(what, f"{needed}; there are {len(k)}")
            continue
        if np.ptp(k) == 0.0 or np.ptp(b) == 0.0:
            yield Skipped(what, "all subjects made the same adjustments of one parameter")
            continue
        yield SubjectPairs(family, environment, displayable(k), displayable(b))


def laws_of(
    pairs: Sequence[SubjectPairs],
    fit: Fit | None,
    asked: InferenceTable,
    environments: Collection[str],
) -> Iterator[Law]:
    """Yield the laws of every method in some environments."""
    kinds = [kind for kind in _LAW_KINDS if kind in asked.kinds]
    for of_subjects in pairs:
        if of_subjects.environment in environments:
            yield from _classical_laws(of_subjects, kinds, asked.level)
    if fit is not None and is_impedance(fit.parameters):
        yield from _laws_of_fit(fit, asked, environments)


def _classical_laws(pairs: SubjectPairs, kinds: Sequence[LawKind], level: float) -> Iterator[Law]:
    """Yield the laws behind the classical intervals, with Hotelling's ellipses."""
    family = pairs.family
    for kind in kinds:
        # Values may still be so near one another that rounding leaves them no scatter.
        with suppress(RefusalError):
            pair = confidence_law(pairs.k, pairs.b, kind=kind, family=family)
            ellipse = None
            # Subjects on a line have a law, and no ellipse.
            with suppress(RefusalError):
                ellipse = ellipse_region(pairs.k, pairs.b, kind=kind, level=level, family=family)
            yield Law(
                environment=pairs.environment,
                kind=kind,
                method="classical",
                family=family,
                level=level,
                pair=pair,
                ellipse=ellipse,
            )


def _laws_of_fit(fit: Fit, asked: InferenceTable, environments: Collection[str]) -> Iterator[Law]:
    """Yield the laws of each environment, where one model has both quantities."""
    wanted = [name for name in fit.environments if name in environments]
    if len(fit.model.parts) != 1 or not wanted:
        return
    batch = fit.run.batches()
    for environment, pairs, scale in pairs_of_fit(fit, fit.points, wanted):
        n = int(fit.counts[fit.column["k", environment]])
        yield from posterior_laws(environment, pairs, batch, n, scale, asked)


def pairs_of_fit(
    fit: Fit, points: Array, environments: Sequence[str]
) -> Iterator[tuple[str, Joint, ResponseScale]]:
    """Yield the laws of stiffness and damping of environments, as responses, and their scale."""
    cells = [fit.pair(environment) for environment in environments]
    pairs = fit.model.joint(points, fit.model.cell_rows[np.array(cells)]).apart()
    for environment, of_environment, columns in zip(environments, pairs, cells, strict=True):
        yield environment, of_environment, fit.scale.at(columns)


def posterior_laws(
    environment: str,
    pairs: Joint,
    batch: NDArray[np.intp],
    n: int,
    scale: ResponseScale,
    asked: InferenceTable,
) -> Iterator[Law]:
    """Yield the laws of k and b of the average and the next user, from n subjects.

    They mix the normal laws of all posterior draws, whose batches are given.
    """
    mean = scale.centre + scale.unit * pairs.mean[:, 0]
    units = np.multiply.outer(scale.unit, scale.unit)
    for kind in _LAW_KINDS:
        if kind in asked.kinds:
            covariance = pairs.location[:, 0]
            if kind == "user":
                covariance = covariance + pairs.users[:, 0]
            pair = mixture_law(mean, units * covariance, batch, asked.family)
            yield Law(
                environment=environment,
                kind=kind,
                method="bayesian",
                family=asked.family,
                level=asked.level,
                pair=pair,
                ellipse=pair.ellipse(kind=kind, level=asked.level, n=n),
            )
