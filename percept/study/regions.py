"""Regions and draws of (k, b) that boundaries come from: of every method, kind and joint treatment."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from percept.boundary.draws import confidence_draws, ellipse_of_draws
from percept.errors import RefusalError
from percept.inference.classical.trials import subject_means
from percept.inference.record import Family, Kind
from percept.inference.regions import EllipseRegion, ellipse_region
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.study.basics import FAMILIES, Array, Skipped, Stream, generator, results
from percept.study.intervals import Limits, paired_limits

if TYPE_CHECKING:
    from percept.study.fit import Fit

#: Of k and of b, each (N,), N/m and N·s/m, by environment.
Pairs = dict[str, tuple[Array, Array]]
# Where little is known a spread, and so a draw or a limit, may leave the range of doubles; beyond this many
# N/m or N·s/m no curve of interest changes.
_LARGEST = 1e40
#: What a covariance of k and b needs.
_FEWEST_SUBJECTS = 3
# As many as there is information for: several conditional draws per effective draw of the scales ...
_POSTERIOR = 16_384
# ... and evenly spread ones, whose quantiles are as good as those of ten times as many independent ones.
_CLASSICAL = 8_192


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

    def depths(self, stiffness: Array, damping: Array) -> Array:
        """Measure how deep inside points lie: from each edge, in widths, or from the curve, in radii."""
        if self.ellipse is not None:
            distance = self.ellipse.distance(stiffness, damping) / self.ellipse.radius
            return np.maximum(1.0 - distance, -1e300)[None]
        assert self.limits is not None
        rows = []
        for value, (low, high) in zip((stiffness, damping), self.limits, strict=True):
            width = high - low or 1.0
            rows += [(value - low) / width, (high - value) / width]
        return np.stack(rows)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Draws:
    """Draws of (k, b) per environment that curves are drawn through."""

    kind: str
    method: str
    family: str
    level: float  # Level of the bands
    pairs: Pairs


@dataclasses.dataclass(frozen=True, eq=False)
class Sources:
    """What ellipses and curves through draws of (k, b) come from."""

    kinds: tuple[Kind, ...] = ()  # Those that are drawn
    pairs: Mapping[Family, Pairs] = dataclasses.field(default_factory=dict)  # Subjects' values
    posterior: bool = False  # Whether a posterior is drawn from
    skipped: Sequence[Skipped] = ()


def displayable(values: Array) -> Array:
    """Bring draws and limits (N/m, N·s/m) into the range that impedances can be worked out for."""
    return np.copysign(np.clip(np.abs(values), 1.0 / _LARGEST, _LARGEST), values)


def regions_of(
    intervals: pd.DataFrame,
    sources: Sources,
    draws: Sequence[Draws],
    fit: Fit | None,
    asked: InferenceTable,
) -> tuple[Region, ...]:
    """Put together the regions of every method; ellipses of a fit go around its draws."""
    found = [*rectangles(intervals), *_classical_ellipses(sources, asked.level)]
    if fit is not None and len(fit.parameters) == 2:
        found += _bonferroni(fit, asked)
        counts = {e: int(fit.counts[c]) for (_, e), c in fit.column.items()}
        for drawn in draws:
            if drawn.method == "bayesian":
                found += draw_ellipses(drawn, counts)
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
    if len(parameters) < 2:
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
    if device and (classical or posterior):
        why = "a band symmetric in logs does not suit skewed draws: it can lie inside the pointwise band"
        skipped.append(Skipped("simultaneous bands through draws", why))
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


def _classical_ellipses(sources: Sources, level: float) -> Iterator[Region]:
    """Hotelling's ellipses of the average and the next user, in both families."""
    for family, values in sources.pairs.items():
        for environment, (k, b) in values.items():
            for kind in sources.kinds:
                try:
                    ellipse = ellipse_region(k, b, kind=kind, level=level, family=family)  # type: ignore[arg-type]
                except RefusalError:
                    continue
                yield from _around(environment, ellipse)


def draw_ellipses(draws: Draws, counts: Mapping[str, int]) -> Iterator[Region]:
    """Ellipses that hold the level of posterior draws."""
    for environment, (k, b) in draws.pairs.items():
        ellipse = ellipse_of_draws(
            k,
            b,
            kind=draws.kind,  # type: ignore[arg-type]
            family=draws.family,  # type: ignore[arg-type]
            level=draws.level,
            n=counts[environment],
        )
        yield from _around(environment, ellipse)


def _around(environment: str, ellipse: EllipseRegion) -> Iterator[Region]:
    """Yield the region of an ellipse; none of one of logarithms that leaves the range of doubles."""
    reach = np.abs(ellipse.centre) + ellipse.radius * ellipse.sd
    if ellipse.family == "normal" or reach.max() < np.log(_LARGEST):
        labels = {name: getattr(ellipse, name) for name in ("kind", "method", "family", "joint", "level")}
        yield Region(environment=environment, ellipse=ellipse, **labels)


def draws_of(sources: Sources, fit: Fit | None, asked: InferenceTable) -> tuple[Draws, ...]:
    """Put together the draws of every method."""
    found = list(_classical_draws(sources, asked))
    if fit is not None and sources.posterior:
        found += _posterior_draws(fit, asked, sources.kinds)
    return tuple(found)


def _posterior_draws(fit: Fit, asked: InferenceTable, kinds: Sequence[str]) -> Iterator[Draws]:
    """Draw the average and the next user of every environment, several times per kept set of scales."""
    repeats = max(1, round(_POSTERIOR / len(fit.points)))
    rng = generator(asked.seed, Stream.POSTERIOR_CURVES)
    drawn = fit.model.draw(np.repeat(fit.points, repeats, axis=0), rng)
    for kind, responses in zip(("mean", "user"), drawn, strict=True):
        if kind in kinds:
            pairs = fit.pairs(displayable(fit.scale.native(responses)))
            yield Draws(kind=kind, method="bayesian", family=asked.family, level=asked.level, pairs=pairs)


def _classical_draws(sources: Sources, asked: InferenceTable) -> Iterator[Draws]:
    """Draw from the distributions behind the classical intervals, in both families."""
    rng = generator(asked.seed, Stream.CLASSICAL_CURVES)
    for family, values in sources.pairs.items():
        for kind in sources.kinds:
            found: Pairs = {}
            for environment, (k, b) in values.items():
                try:
                    # Twice, so that the halves are independent and each is evenly spread.
                    halves = [
                        confidence_draws(k, b, kind=kind, family=family, draws=_CLASSICAL // 2, rng=rng)
                        for _ in range(2)
                    ]
                except RefusalError:
                    continue
                drawn = np.concatenate(halves, axis=1)
                found[environment] = displayable(drawn[0]), displayable(drawn[1])
            yield Draws(kind=kind, method="classical", family=family, level=asked.level, pairs=found)
