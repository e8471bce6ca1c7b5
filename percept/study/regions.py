"""Regions and laws of (k, b) that boundaries come from: of every method, kind and joint treatment."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.boundary.law import PairLaw, confidence_law, mixture_law
from percept.errors import RefusalError
from percept.inference.classical.trials import subject_means
from percept.inference.record import Family, Kind
from percept.inference.regions import EllipseRegion, ellipse_region
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.quantities import is_impedance
from percept.study.basics import FAMILIES, Array, Skipped, results

if TYPE_CHECKING:
    from percept.study.fit import Fit
    from percept.study.responses import ResponseScale

#: Of k and of b, each (N,), N/m and N·s/m, by environment.
Pairs = dict[str, tuple[Array, Array]]
Limits = tuple[float, float]
# Where little is known a spread, and so a draw or a limit, may leave the range of doubles; beyond this many
# N/m or N·s/m no curve of interest changes.
_LARGEST = 1e40
#: What a covariance of k and b needs.
_FEWEST_SUBJECTS = 3


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """A rectangle or an ellipse of (k, b) that feels like an environment."""

    environment: str
    kind: str
    method: str
    family: str
    joint: str
    level: float  # Level asked for
    limits: tuple[Limits, Limits] | None = None  # Of stiffness and of damping, N/m and N·s/m
    ellipse: EllipseRegion | None = None  # None for a rectangle


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """What a method says of the stiffness and damping of the average or the next user together."""

    environment: str
    kind: str
    method: str
    family: str
    level: float  # Level of the bands and of the ellipse
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
        return Region(ellipse=self.ellipse, joint=self.ellipse.joint, **labels_of(self))


def labels_of(source: Region | Law) -> dict[str, Any]:
    """Return what a region or law has in common with the curves drawn for it."""
    return {name: getattr(source, name) for name in ("environment", "kind", "method", "family", "level")}


@dataclasses.dataclass(frozen=True, eq=False)
class Sources:
    """What ellipses and curves of laws of (k, b) come from."""

    kinds: tuple[Kind, ...] = ()  # Those that are drawn
    pairs: Mapping[Family, Pairs] = dataclasses.field(default_factory=dict)  # Subjects' values
    posterior: bool = False  # Whether a posterior is drawn from
    skipped: Sequence[Skipped] = ()


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
    labels = ["environment", "kind", "method", "family", "joint", "level"]
    of_k, of_b = (intervals.loc[intervals["parameter"] == p, [*labels, "lower", "upper"]] for p in ("k", "b"))
    both = of_k.merge(of_b, on=labels, suffixes=("_k", "_b"))
    ends = displayable(both[["lower_k", "upper_k", "lower_b", "upper_b"]].to_numpy(dtype=float)).tolist()
    for own, (k_low, k_high, b_low, b_high) in zip(both[labels].to_dict("records"), ends, strict=True):
        yield Region(limits=((k_low, k_high), (b_low, b_high)), **own)  # type: ignore[arg-type]


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
        ends = displayable(fit.scale.native(np.stack(halved.limits(kind, laws)[:2])))
        for environment, (k, b) in fit.pairs(ends).items():
            limits = (float(k[0]), float(k[1])), (float(b[0]), float(b[1]))
            yield Region(environment=environment, kind=kind, joint="bonferroni", limits=limits, **labels)


def sources_of(sessions: Sessions, scene: Scene, parameters: Sequence[str], *, device: bool) -> Sources:
    """Find what ellipses and curves can be drawn through, and say what cannot; nothing with one parameter."""
    asked, skipped = scene.inference, list[Skipped]()
    if sessions.form == "summary":
        why = "published limits do not hold them"
        skipped.append(Skipped("subject effects and k-b correlation", why))
    if not is_impedance(parameters):
        return Sources(skipped=skipped)
    if "share" in asked.kinds:
        skipped.append(Skipped("ellipse of kind share", "there is no exact ellipse of a share of users"))
        if device:
            why = "a share of users has no curve of its own"
            skipped.append(Skipped("curves through draws, kind share", why))
    if sessions.form == "summary":
        why = "published limits hold no correlation of k and b"
        return Sources(skipped=[*skipped, Skipped("ellipses and curves through draws", why)])
    posterior = asked.method != "classical"
    if posterior and scene.model.pooling == "none":
        posterior = False
        why = "cells without pooling hold no correlation of k and b"
        skipped.append(Skipped("Bayesian ellipses and curves through draws", why))
    pairs: dict[Family, Pairs] = {}
    for family in FAMILIES if asked.method != "bayesian" else ():
        found = list(_subject_pairs(sessions, family))
        pairs[family] = dict(results(found))
        skipped += [part for part in found if isinstance(part, Skipped)]
    return Sources(tuple(kind for kind in asked.kinds if kind != "share"), pairs, posterior, skipped)


def _subject_pairs(sessions: Sessions, family: Family) -> Iterator[tuple[str, tuple[Array, Array]] | Skipped]:
    """Take one stiffness and one damping per subject and environment, of the trials that have both."""
    for environment, table in sessions.by_environment():
        rows = table[table[["k_adj", "b_adj"]].notna().all(axis=1)]
        if rows.empty:
            continue
        subjects = rows["subject"].to_numpy()
        adjusted = rows[["k_adj", "b_adj"]].to_numpy(dtype=float)
        if (count := rows["subject"].nunique()) < _FEWEST_SUBJECTS:
            yield Skipped(
                f"classical ellipses and curves through draws of {environment}",
                f"they need {_FEWEST_SUBJECTS} subjects with both parameters; there are {count}",
            )
        elif family == "normal" or (adjusted > 0).all():
            k, b = (
                displayable(subject_means(column, subjects, family=family).values) for column in adjusted.T
            )
            yield environment, (k, b)


def laws_of(sources: Sources, fit: Fit | None, asked: InferenceTable) -> tuple[Law, ...]:
    """Put together the laws of every method."""
    found = list(_classical_laws(sources, asked.level))
    if fit is not None and sources.posterior:
        found += _posterior_laws(fit, asked, sources.kinds)
    return tuple(found)


def _classical_laws(sources: Sources, level: float) -> Iterator[Law]:
    """Yield the laws behind the classical intervals in both families, with Hotelling's ellipses."""
    for family, values in sources.pairs.items():
        labels: dict[str, Any] = {"method": "classical", "family": family, "level": level}
        for environment, (k, b) in values.items():
            for kind in sources.kinds:
                with suppress(RefusalError):
                    pair, ellipse = confidence_law(k, b, kind=kind, family=family), None
                    # Subjects on a line have a law, and no ellipse.
                    with suppress(RefusalError):
                        ellipse = ellipse_region(k, b, kind=kind, level=level, family=family)  # type: ignore[arg-type]
                    yield Law(environment=environment, kind=kind, pair=pair, ellipse=ellipse, **labels)


def _posterior_laws(fit: Fit, asked: InferenceTable, kinds: Sequence[str]) -> Iterator[Law]:
    from percept.inference.hierarchy.density import CollapsedDensity

    assert isinstance(fit.model, CollapsedDensity)
    mean, own, users = fit.model.pairs(fit.points)
    batch = fit.run.batches()
    for j, environment in enumerate(fit.environments):
        cells = [fit.column[parameter, environment] for parameter in ("k", "b")]
        scale, n = fit.scale.of_cells(cells), int(fit.counts[cells[0]])
        for kind in kinds:
            covariance = own[:, j] if kind == "mean" else own[:, j] + users[:, j]
            yield posterior_law(environment, kind, scale, mean[:, j], covariance, batch, n, asked)


def posterior_law(
    environment: str,
    kind: str,
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
    ellipse = pair.ellipse(kind=kind, level=asked.level, n=n)  # type: ignore[arg-type]
    labels: dict[str, Any] = {"method": "bayesian", "family": asked.family, "level": asked.level}
    return Law(environment=environment, kind=kind, pair=pair, ellipse=ellipse, **labels)
