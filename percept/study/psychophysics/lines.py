"""Points of subjective equality over the reference: the line that environments scatter about.

Given a draw of the scales a line's intercept and slope are jointly normal, so that its limits at
any reference are roots of a mixture of normal laws, as limits at environments are.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from percept.inference.model.laws import Moments
from percept.inference.model.predictions import trend_rows
from percept.results import PseLineRow, Skipped
from percept.study.basics import Array
from percept.study.data import Data
from percept.study.fit import Fit
from percept.study.psychophysics.limits import bounded_means
from percept.study.psychophysics.site import exp, mapped

#: References of a line, evenly spaced in decades: its limits are smooth between them.
_POINTS = 25
#: Two references lie on any line.
_FEWEST_REFERENCES = 3
#: Tolerances beyond which the error of a limit withholds a line, as it does other curves.
_MOST_TOLERANCES = 10.0


def posterior_lines(fit: Fit, data: Data) -> Iterator[PseLineRow | Skipped]:
    """Yield the line of each quantity in each condition, reference by reference."""
    for density, points in fit.model.split(fit.points):
        tested: dict[int, Array] = {}
        for p, parameter in enumerate(density.statistics.parameters):
            names = density.statistics.environments
            references = np.array([data.reference[parameter, name] for name in names])
            why = _why_not(np.unique(references))
            if why:
                yield Skipped(_what(data, parameter), why)
            else:
                tested[p] = references
        if not tested:
            continue
        subjects = len(density.statistics.subjects)
        for condition, (heights, slopes) in trend_rows(density).items():
            for p, references in tested.items():
                where = density.statistics.parameters[p], condition
                at = _references(references)
                decades = np.log10(at) - np.log10(references).mean()
                rows = heights[p] + np.multiply.outer(decades, slopes[p])
                laws = density.moments(points, rows)
                yield from _line(laws, at, data, where, subjects)


def _what(data: Data, parameter: str) -> str:
    return f"line of {data.quantities[parameter].label} over the reference"


def _why_not(references: Array) -> str:
    """Say why different references have no line; empty where they have."""
    if references[0] <= 0.0:
        return "a reference of zero or below has no logarithm"
    if len(references) < _FEWEST_REFERENCES:
        return (
            f"it needs {_FEWEST_REFERENCES} different references, and there are {len(references)}"
        )
    return ""


def _references(tested: Array) -> Array:
    """Return the references of a line: it ends where the study ends."""
    return np.geomspace(tested.min(), tested.max(), _POINTS)


def _line(
    laws: Moments, at: Array, data: Data, where: tuple[str, str], subjects: int
) -> Iterator[PseLineRow | Skipped]:
    """Yield a row for each reference, from the laws of responses there."""
    asked = data.asked
    parameter, condition = where
    limits_at = bounded_means(laws, asked.level, len(laws.mean))
    # In half-widths.
    worst = max(2.0 * (own.error or 0.0) / (own.upper - own.lower) for own in limits_at)
    if worst > _MOST_TOLERANCES * asked.tolerance:
        why = f"the Monte Carlo error of its limits is {worst:.0%} of a half-width"
        yield Skipped(_what(data, parameter), why)
        return
    for reference, limits in zip(at.tolist(), limits_at, strict=True):

        def native(response: float, reference: float = reference) -> float:
            log = asked.family == "lognormal"
            return reference * (exp(response) if log else 1.0 + response)

        yield PseLineRow(
            parameter=parameter,
            condition=condition,
            method="bayesian",
            family=asked.family,
            level=asked.level,
            reference=reference,
            **vars(mapped(limits, native)),
            unit=data.quantities[parameter].unit,
            n=subjects,
        )
