"""Points of subjective equality over the reference: the line that environments scatter about.

Given a draw of the scales a line's intercept and slope are jointly normal, so that its limits at
any reference are roots of a mixture of normal laws, as limits at environments are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from percept.inference.classical.variability import Bounded
from percept.inference.model.model import LinearModel
from percept.inference.model.predictions import trend_rows
from percept.results import PseLineRow
from percept.scene import InferenceTable
from percept.study.basics import Array, Skipped
from percept.study.data import Data
from percept.study.fit import Fit
from percept.study.psychophysics.limits import bounded_means
from percept.study.psychophysics.site import exp, mapped

__all__ = ["posterior_lines"]

#: References of a line, evenly spaced in decades: its limits are smooth between them.
_POINTS = 25
#: Two references lie on any line.
_FEWEST_REFERENCES = 3
#: Tolerances beyond which the error of a limit withholds a line, as it does other curves.
_MOST_TOLERANCES = 10.0


def posterior_lines(fit: Fit, data: Data) -> Iterator[PseLineRow | Skipped]:
    """Yield the line of each quantity in each condition, reference by reference."""
    for density, points in fit.model.split(fit.points):
        lines = []
        for p, parameter in enumerate(density.statistics.parameters):
            names = density.statistics.environments
            tested = np.array([data.reference[parameter, name] for name in names])
            why = _why_not(np.unique(tested))
            if why:
                what = f"line of {fit.quantities[parameter].label} over the reference"
                yield Skipped(what, why)
            else:
                lines.append(_Line(fit, density, data.asked, p, tested))
        if lines:
            for condition, (heights, slopes) in trend_rows(density).items():
                for line in lines:
                    height = heights[line.number]
                    slope = slopes[line.number]
                    yield from line.rows(condition, points, height, slope)


def _why_not(references: Array) -> str:
    """Say why different references have no line; empty where they have."""
    if references[0] <= 0.0:
        return "a reference of zero or below has no logarithm"
    if len(references) < _FEWEST_REFERENCES:
        return (
            f"it needs {_FEWEST_REFERENCES} different references, and there are {len(references)}"
        )
    return ""


@dataclass(frozen=True, eq=False)
class _Line:
    """What the lines of one quantity have in common."""

    fit: Fit
    density: LinearModel
    asked: InferenceTable
    number: int  # Of the quantity, in its model
    tested: Array  # (J,) References of the environments

    def rows(
        self, condition: str, points: Array, height: Array, slope: Array
    ) -> Iterator[PseLineRow | Skipped]:
        """Yield a row for each reference, by weights (R,) of the line's height and its slope."""
        asked = self.asked
        quantity = self.fit.quantities[self.density.statistics.parameters[self.number]]
        references = np.geomspace(self.tested.min(), self.tested.max(), _POINTS)
        decades = np.log10(references) - np.log10(self.tested).mean()
        rows = height + np.multiply.outer(decades, slope)
        limits_at = bounded_means(self.density.moments(points, rows), asked.level, len(points))
        # In half-widths.
        worst = max(2.0 * (own.error or 0.0) / (own.upper - own.lower) for own in limits_at)
        if worst > _MOST_TOLERANCES * asked.tolerance:
            what = f"line of {quantity.label} over the reference"
            why = f"the Monte Carlo error of its limits is {worst:.0%} of a half-width"
            yield Skipped(what, why)
            return
        for value, limits in zip(references.tolist(), limits_at, strict=True):
            pse = self._native(value, limits)
            yield PseLineRow(
                parameter=quantity.name,
                condition=condition,
                method="bayesian",
                family=asked.family,
                level=asked.level,
                reference=value,
                estimate=pse.estimate,
                lower=pse.lower,
                upper=pse.upper,
                error=pse.error,
                unit=quantity.unit,
                n=len(self.density.statistics.subjects),
            )

    def _native(self, reference: float, bounded: Bounded) -> Bounded:
        """Return responses to a reference in its unit."""
        if self.fit.scale.log:
            return mapped(bounded, lambda response: reference * exp(response))
        return mapped(bounded, lambda response: reference * (1.0 + response))
