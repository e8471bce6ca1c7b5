"""Regions and laws of (k, b) that boundaries come from: of every method, kind and joint treatment."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.boundary.law import PairLaw, confidence_law, mixture_law
from percept.errors import RefusalError
from percept.inference.classical.trials import subject_means
from percept.inference.record import Family
from percept.inference.regions import EllipseRegion, ellipse_region
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.quantities import is_impedance
from percept.study.basics import FAMILIES, Array, Skipped

if TYPE_CHECKING:
    from percept.study.fit import Fit
    from percept.study.responses import ResponseScale

Limits = tuple[float, float]
#: A share of users has neither a law nor an ellipse.
LawKind = Literal["mean", "user"]
_LAWS: tuple[LawKind, ...] = ("mean", "user")
# Where little is known a spread, and so a draw or a limit, may leave the range of doubles; beyond
# this many N/m or N·s/m no curve of interest changes.
_LARGEST = 1e40
#: What a covariance of k and b needs.
_FEWEST_SUBJECTS = 3


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class _Labelled:
    environment: str
    kind: str
    method: str
    family: str
    level: float  # Level asked for

    @property
    def labels(self) -> dict[str, Any]:
        """What a region or law has in common with the curves drawn for it."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(_Labelled)}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Region(_Labelled):
    """A rectangle or an ellipse of (k, b) that feels like an environment."""

    joint: str
    limits: tuple[Limits, Limits] | None = None  # Of stiffness and of damping, N/m and N·s/m
    ellipse: EllipseRegion | None = None  # None for a rectangle


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Law(_Labelled):
    """What a method says of the stiffness and damping of the average or the next user together."""

    pair: PairLaw
    ellipse: EllipseRegion | None  # None where the subjects' values give none

    @property
    def region(self) -> Region | None:
        """The ellipse as a region; None where its ends leave the range that curves are drawn for."""
        if self.ellipse is None:
            return None
        reach = np.abs(self.ellipse.centre) + self.ellipse.radius * self.ellipse.sd
        if self.family == "lognormal" and reach.max() >= np.log(_LARGEST):
            return None
        return Region(ellipse=self.ellipse, joint=self.ellipse.joint, **self.labels)


class Pairs(NamedTuple):
    """One stiffness and one damping of each of N subjects in an environment."""

    family: Family  # Of the scale that a subject's trials are averaged on
    environment: str
    k: Array  # (N,) N/m
    b: Array  # (N,) N·s/m


def displayable(values: Array) -> Array:
    """Bring draws and limits (N/m, N·s/m) into the range that impedances can be worked out for."""
    return np.copysign(np.clip(np.abs(values), 1.0 / _LARGEST, _LARGEST), values)


def regions_of(
    intervals: pd.DataFrame, laws: Sequence[Law], fit: Fit | None, asked: InferenceTable
) -> tuple[Region, ...]:
    """Put together the rectangles of every method, and the ellipses of its laws."""
    found = list(rectangles(intervals))
    if fit is not None and is_impedance(fit.parameters):
        found += _bonferroni(fit, asked)
    return (*found, *(law.region for law in laws if law.region is not None))


def rectangles(intervals: pd.DataFrame) -> Iterator[Region]:
    """Pair the intervals of stiffness and damping."""
    names = ["environment", "kind", "method", "family", "joint", "level"]
    of_k, of_b = (
        intervals.loc[intervals["parameter"] == p, [*names, "lower", "upper"]] for p in ("k", "b")
    )
    both = of_k.merge(of_b, on=names, suffixes=("_k", "_b"))
    ends = displayable(
        both[["lower_k", "upper_k", "lower_b", "upper_b"]].to_numpy(dtype=float)
    ).tolist()
    for row, (k_low, k_high, b_low, b_high) in zip(
        both[names].to_numpy().tolist(), ends, strict=True
    ):
        yield Region(
            limits=((k_low, k_high), (b_low, b_high)), **dict(zip(names, row, strict=True))
        )


def _bonferroni(fit: Fit, asked: InferenceTable) -> Iterator[Region]:
    """Posterior rectangles whose sides leave out half as much each, so that both hold at the level."""
    from percept.inference.hierarchy.models import IntervalEstimands

    level, share, confidence = (
        1.0 - 0.5 * (1.0 - part) for part in (asked.level, asked.held_share, asked.confidence)
    )
    halved = IntervalEstimands(fit.model, level=level, share=share, confidence=confidence)
    laws = fit.model.laws(fit.points)
    labels: dict[str, Any] = {"method": "bayesian", "family": asked.family, "level": asked.level}
    for kind in asked.kinds:
        limits = halved.limits(kind, laws)
        ends = displayable(fit.scale.native(np.stack([limits.lower, limits.upper])))
        for environment, (k, b) in fit.pairs(ends).items():
            sides = (float(k[0]), float(k[1])), (float(b[0]), float(b[1]))
            yield Region(
                environment=environment, kind=kind, joint="bonferroni", limits=sides, **labels
            )


def subject_pairs(
    sessions: Sessions, scene: Scene, parameters: Sequence[str], *, device: bool
) -> Iterator[Pairs | Skipped]:
    """Yield what classical ellipses and laws come from, and the ellipses and laws there are none of."""
    asked, limits = scene.inference, sessions.form == "summary"
    if limits:
        yield Skipped("subject effects and k-b correlation", "published limits do not hold them")
    if not is_impedance(parameters):
        return
    if "share" in asked.kinds:
        yield Skipped("ellipse of kind share", "there is no exact ellipse of a share of users")
        if device:
            why = "a share of users has no curve of its own"
            yield Skipped("curves through draws, kind share", why)
    if limits:
        why = "published limits hold no correlation of k and b"
        yield Skipped("ellipses and curves through draws", why)
        return
    if asked.method != "classical" and scene.model.pooling == "none":
        why = "cells without pooling hold no correlation of k and b"
        yield Skipped("Bayesian ellipses and curves through draws", why)
    for family in FAMILIES if asked.method != "bayesian" else ():
        for environment, table in sessions.by_environment():
            rows = table[table[["k_adj", "b_adj"]].notna().all(axis=1)]
            subjects, adjusted = rows["subject"], rows[["k_adj", "b_adj"]].to_numpy(dtype=float)
            if 0 < (count := subjects.nunique()) < _FEWEST_SUBJECTS:
                yield Skipped(
                    f"classical ellipses and curves through draws of {environment}",
                    f"they need {_FEWEST_SUBJECTS} subjects with both parameters; there are"
                    f" {count}",
                )
            elif count and (family == "normal" or (adjusted > 0).all()):
                k, b = (
                    subject_means(x, subjects.to_numpy(), family=family).values for x in adjusted.T
                )
                yield Pairs(family, environment, displayable(k), displayable(b))


def laws_of(pairs: Sequence[Pairs], fit: Fit | None, asked: InferenceTable) -> tuple[Law, ...]:
    """Put together the laws of every method."""
    kinds = [kind for kind in _LAWS if kind in asked.kinds]
    found = [law for pair in pairs for law in _classical_laws(pair, kinds, asked.level)]
    if fit is not None and is_impedance(fit.parameters):
        found += _posterior_laws(fit, asked, kinds)
    return tuple(found)


def _classical_laws(pairs: Pairs, kinds: Sequence[LawKind], level: float) -> Iterator[Law]:
    """Yield the laws behind the classical intervals, with Hotelling's ellipses."""
    family, environment, k, b = pairs
    for kind in kinds:
        with suppress(RefusalError):
            pair, ellipse = confidence_law(k, b, kind=kind, family=family), None
            # Subjects on a line have a law, and no ellipse.
            with suppress(RefusalError):
                ellipse = ellipse_region(k, b, kind=kind, level=level, family=family)
            yield Law(
                environment=environment, kind=kind, method="classical", family=family, level=level,
                pair=pair, ellipse=ellipse,
            )  # fmt: skip


def _posterior_laws(fit: Fit, asked: InferenceTable, kinds: Sequence[LawKind]) -> Iterator[Law]:
    parts = fit.model.pooled_parts(fit.points)
    if len(parts) != 1:
        return
    ((density, points),) = parts
    pairs = density.pairs(points)
    batch = fit.run.batches()
    for j, environment in enumerate(fit.environments):
        cells = [fit.column[parameter, environment] for parameter in ("k", "b")]
        scale = dataclasses.replace(
            fit.scale, origin=fit.scale.origin[cells], unit=fit.scale.unit[cells]
        )
        n = int(fit.counts[cells[0]])
        for kind in kinds:
            covariance = pairs.location[:, j]
            if kind == "user":
                covariance = covariance + pairs.users[:, j]
            mean = pairs.mean[:, j]
            yield posterior_law(environment, kind, scale, mean, covariance, batch, n, asked)


def posterior_law(
    environment: str,
    kind: LawKind,
    scale: ResponseScale,
    mean: Array,
    covariance: Array,
    batch: NDArray[np.intp],
    n: int,
    asked: InferenceTable,
) -> Law:
    """Return the law of (k, b), responses being normal given each draw, (S, 2) and (S, 2, 2), of n users."""
    centre = np.log(scale.origin) if scale.log else scale.origin
    unit = np.multiply.outer(scale.unit, scale.unit)
    pair = mixture_law(centre + scale.unit * mean, unit * covariance, batch, asked.family)
    return Law(
        environment=environment, kind=kind, method="bayesian", family=asked.family, level=asked.level,
        pair=pair, ellipse=pair.ellipse(kind=kind, level=asked.level, n=n),
    )  # fmt: skip
