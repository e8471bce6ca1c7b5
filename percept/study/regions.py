"""Regions and laws of (k, b) that boundaries come from: of every method, kind and joint treatment."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
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
from percept.study.intervals import Limits, paired_limits

if TYPE_CHECKING:
    from percept.study.fit import Fit
    from percept.study.responses import ResponseScale

#: Of k and of b, each (N,), N/m and N·s/m, by environment.
Pairs = dict[str, tuple[Array, Array]]
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
    level: float  # Level of the bands
    pair: PairLaw
    n: int  # Subjects behind it


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
    intervals: pd.DataFrame, sources: Sources, laws: Sequence[Law], fit: Fit | None, asked: InferenceTable
) -> tuple[Region, ...]:
    """Put together the regions of every method; ellipses of a fit go around its laws."""
    found = [*rectangles(intervals), *classical_ellipses(sources, asked.level)]
    if fit is not None and is_impedance(fit.parameters):
        found += _bonferroni(fit, asked)
        for law in laws:
            if law.method == "bayesian":
                found += law_ellipse(law)
    return tuple(found)


def rectangles(intervals: pd.DataFrame) -> Iterator[Region]:
    """Pair the intervals of stiffness and damping."""
    labels = ("environment", "kind", "method", "family", "joint", "level")
    limits = {side: displayable(intervals[side].to_numpy(dtype=float)) for side in ("lower", "upper")}
    for rows, pair in paired_limits(intervals.assign(**limits), labels):
        yield Region(**{label: rows["k"][label] for label in labels}, limits=pair)


def _bonferroni(fit: Fit, asked: InferenceTable) -> Iterator[Region]:
    """Posterior rectangles whose sides leave out half as much each, so that both hold at the level."""
    from percept.inference.hierarchy.models import IntervalEstimands

    level, share, confidence = (
        1.0 - 0.5 * (1.0 - part) for part in (asked.level, asked.held_share, asked.confidence)
    )
    halved = IntervalEstimands(fit.model, level=level, share=share, confidence=confidence)
    laws = fit.model.laws(fit.points)
    for kind in asked.kinds:
        ends = displayable(fit.scale.native(np.stack(halved.limits(kind, laws)[:2])))
        for environment, pair in fit.pairs(ends).items():
            (k_low, k_high), (b_low, b_high) = (limits.tolist() for limits in pair)
            yield Region(
                environment=environment,
                kind=kind,
                method="bayesian",
                family=asked.family,
                joint="bonferroni",
                level=asked.level,
                limits=((k_low, k_high), (b_low, b_high)),
            )


def sources_of(sessions: Sessions, scene: Scene, parameters: Sequence[str], *, device: bool) -> Sources:
    """Find what ellipses and curves can be drawn through, and say what cannot; nothing with one parameter."""
    asked, skipped = scene.inference, list[Skipped]()
    if not is_impedance(parameters):
        return Sources()
    if "share" in asked.kinds:
        skipped.append(Skipped("ellipse of kind share", "there is no exact ellipse of a share of users"))
        if device:
            why = "a share of users has no curve of its own"
            skipped.append(Skipped("curves through draws, kind share", why))
    if sessions.form == "summary":
        why = "published limits hold no correlation of k and b"
        return Sources(skipped=[*skipped, Skipped("ellipses and curves through draws", why)])
    classical, posterior = asked.method != "bayesian", asked.method != "classical"
    if posterior and scene.model.pooling == "none":
        posterior = False
        why = "cells without pooling hold no correlation of k and b"
        skipped.append(Skipped("Bayesian ellipses and curves through draws", why))
    pairs: dict[Family, Pairs] = {}
    for family in FAMILIES if classical else ():
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


def classical_ellipses(sources: Sources, level: float) -> Iterator[Region]:
    """Hotelling's ellipses of the average and the next user, in both families."""
    for family, values in sources.pairs.items():
        for environment, (k, b) in values.items():
            for kind in sources.kinds:
                try:
                    ellipse = ellipse_region(k, b, kind=kind, level=level, family=family)  # type: ignore[arg-type]
                except RefusalError:
                    continue
                yield from _around(environment, ellipse)


def law_ellipse(law: Law) -> Iterator[Region]:
    """Yield the ellipse that holds the level of a posterior law."""
    yield from _around(law.environment, law.pair.ellipse(kind=law.kind, level=law.level, n=law.n))  # type: ignore[arg-type]


def _around(environment: str, ellipse: EllipseRegion) -> Iterator[Region]:
    """Yield the region of an ellipse; none of one of logarithms that leaves the range of doubles."""
    reach = np.abs(ellipse.centre) + ellipse.radius * ellipse.sd
    if ellipse.family == "normal" or reach.max() < np.log(_LARGEST):
        labels = {name: getattr(ellipse, name) for name in ("kind", "method", "family", "joint", "level")}
        yield Region(environment=environment, ellipse=ellipse, **labels)


def laws_of(sources: Sources, fit: Fit | None, asked: InferenceTable) -> tuple[Law, ...]:
    """Put together the laws of every method."""
    found = list(_classical_laws(sources, asked.level))
    if fit is not None and sources.posterior:
        found += _posterior_laws(fit, asked, sources.kinds)
    return tuple(found)


def _posterior_laws(fit: Fit, asked: InferenceTable, kinds: Sequence[str]) -> Iterator[Law]:
    from percept.inference.hierarchy.models import Pooled

    assert isinstance(fit.model, Pooled)
    mean, own, users = fit.model.pairs(fit.points)
    batch = fit.run.batches()
    for j, environment in enumerate(fit.environments):
        cells = [fit.column[parameter, environment] for parameter in ("k", "b")]
        scale, n = fit.scale.of_cells(cells), int(fit.counts[cells[0]])
        labels: dict[str, Any] = {
            "environment": environment,
            "method": "bayesian",
            "family": asked.family,
            "level": asked.level,
            "n": n,
        }
        for kind in kinds:
            covariance = own[:, j] if kind == "mean" else own[:, j] + users[:, j]
            yield Law(kind=kind, pair=posterior_law(scale, mean[:, j], covariance, batch), **labels)


def posterior_law(scale: ResponseScale, mean: Array, covariance: Array, batch: NDArray[np.intp]) -> PairLaw:
    """Return the law of (k, b) whose responses are normal given each draw, (S, 2) and (S, 2, 2)."""
    centre = np.log(scale.origin) if scale.log else scale.origin
    unit = np.multiply.outer(scale.unit, scale.unit)
    family: Family = "lognormal" if scale.log else "normal"
    return mixture_law(centre + scale.unit * mean, unit * covariance, batch, family)


def _classical_laws(sources: Sources, level: float) -> Iterator[Law]:
    """Yield the laws behind the classical intervals, in both families."""
    for family, values in sources.pairs.items():
        labels: dict[str, Any] = {"method": "classical", "family": family, "level": level}
        for environment, (k, b) in values.items():
            for kind in sources.kinds:
                try:
                    pair = confidence_law(k, b, kind=kind, family=family)
                except RefusalError:
                    continue
                yield Law(environment=environment, kind=kind, pair=pair, n=k.size, **labels)
