"""Regions of (k, b) that boundaries are drawn around: every method, kind and joint treatment of a study."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.boundary.draws import ellipse_of_draws
from percept.errors import RefusalError
from percept.inference.classical.trials import subject_means
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.regions import EllipseRegion, ellipse_region
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.cells import Limits, paired_limits
from percept.study.classical import FAMILIES
from percept.study.posterior import thinned_points

if TYPE_CHECKING:
    from percept.study.bayesian import Fit

Array = NDArray[np.float64]
Family = Literal["normal", "lognormal"]
Pairs = dict[str, tuple[Array, Array]]
# Where little is known a spread, and so a draw or a limit, may leave the range of doubles; beyond this many
# N/m or N·s/m no curve of interest changes.
_LARGEST = 1e40
_SIDES = ("lower", "upper")


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

    kind: str  # What was drawn
    method: str  # What was drawn
    family: str  # What was drawn
    level: float  # Level of the bands
    pairs: Pairs  # Draws of k and b by environment, each (N,), N/m and N·s/m

    def within(self, environment: str) -> Draws:
        """Draws of one environment alone."""
        return dataclasses.replace(self, pairs={environment: self.pairs[environment]})


def displayable(values: Array) -> Array:
    """Bring draws and limits (N/m, N·s/m) into the range that impedances can be worked out for."""
    return np.copysign(np.clip(np.abs(values), 1.0 / _LARGEST, _LARGEST), values)


def rectangles(intervals: pd.DataFrame) -> Iterator[Region]:
    """Pair the intervals of stiffness and damping."""
    if intervals.empty:
        return
    shown = intervals.assign(**{side: displayable(intervals[side].to_numpy()) for side in _SIDES})
    labels = ("environment", "kind", "method", "family", "joint")
    for rows, limits in paired_limits(shown, labels):
        said: dict[str, Any] = {label: str(rows["k"][label]) for label in labels}
        yield Region(**said, level=float(rows["k"]["level"]), limits=limits)


def subject_pairs(sessions: Sessions, family: Family) -> Pairs:
    """Take one stiffness and one damping per subject and environment, of the trials that have both."""
    complete = sessions.table[sessions.table[["k_adj", "b_adj"]].notna().all(axis=1)]
    pairs: Pairs = {}
    for environment, rows in complete.groupby("environment", sort=False):
        adjusted = rows[["k_adj", "b_adj"]].to_numpy(dtype=float)
        if family == "lognormal" and (adjusted <= 0).any():
            continue
        k, b = (
            displayable(subject_means(column, rows["subject"].to_numpy(), family=family).values)
            for column in adjusted.T
        )
        pairs[str(environment)] = k, b
    return pairs


def classical_ellipses(sessions: Sessions, scene: Scene) -> Iterator[Region]:
    """Hotelling's ellipses of the average and the next user, in both families."""
    if sessions.form == "summary":
        return
    level = scene.inference.level
    for family in FAMILIES:
        for environment, (k, b) in subject_pairs(sessions, family).items():  # type: ignore[arg-type]
            for kind in ("mean", "user"):
                if kind not in scene.inference.kinds:
                    continue
                try:
                    ellipse = ellipse_region(k, b, kind=kind, level=level, family=family)  # type: ignore[arg-type]
                except RefusalError:
                    continue
                if _representable(ellipse):
                    yield _around(environment, ellipse)


def draw_ellipses(draws: Draws, counts: dict[str, int]) -> Iterator[Region]:
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
        if _representable(ellipse):
            yield _around(environment, ellipse)


def bonferroni_regions(fit: Fit, scene: Scene) -> Iterator[Region]:
    """Posterior rectangles whose sides leave out half as much each, so that both hold at the level."""
    asked = scene.inference
    model = fit.prepared.model
    halved = IntervalEstimands(
        model,
        level=_halved(asked.level),
        share=_halved(asked.held_share),
        confidence=_halved(asked.confidence),
    )
    laws = model.laws(thinned_points(fit)[0])
    for kind in asked.kinds:
        lower, upper = (displayable(fit.prepared.scale.native(end)) for end in halved.limits(kind, laws)[:2])
        limits = {cell: (float(lower[c]), float(upper[c])) for c, cell in enumerate(model.cells)}
        for environment in dict.fromkeys(e for _, e in model.cells):
            yield Region(
                environment=environment,
                kind=kind,
                method="bayesian",
                family=asked.family,
                joint="bonferroni",
                level=asked.level,
                limits=(limits["k", environment], limits["b", environment]),
            )


def _representable(ellipse: EllipseRegion) -> bool:
    """Say whether an ellipse of logarithms stays in the range of doubles: no curve is drawn where not."""
    if ellipse.family == "normal":
        return True
    reach = np.abs(ellipse.centre) + ellipse.radius * ellipse.sd
    return bool(reach.max() < np.log(_LARGEST))


def _halved(level: float) -> float:
    return 1.0 - 0.5 * (1.0 - level)


def _around(environment: str, ellipse: EllipseRegion) -> Region:
    return Region(
        environment=environment,
        kind=ellipse.kind,
        method=ellipse.method,
        family=ellipse.family,
        joint=ellipse.joint,
        level=ellipse.level,
        ellipse=ellipse,
    )
