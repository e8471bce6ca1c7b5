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
from percept.study.fit import Fit
from percept.study.psychophysics.posterior import DrawLimits
from percept.study.psychophysics.rows import mapped
from percept.study.responses import ResponseScale

#: References of a line, evenly spaced in decades: its limits are smooth between them.
_POINTS = 25
#: Two references lie on any line.
_FEWEST_REFERENCES = 3
#: Tolerances beyond which the error of a limit withholds a line, as it does other curves.
_MOST_TOLERANCES = 10.0


def posterior_lines(fit: Fit) -> Iterator[PseLineRow | Skipped]:
    """Yield the line of each quantity in each condition, reference by reference."""
    for model, points in fit.model.split(fit.points):
        statistics = model.statistics
        tested: dict[int, Array] = {}
        for p, parameter in enumerate(statistics.parameters):
            of_all = [fit.data.reference[parameter, name] for name in statistics.environments]
            if why := _why_not(of_all):
                yield Skipped(_what(fit, parameter), why)
            else:
                tested[p] = np.array(of_all)
        if not tested:
            continue
        for condition, (heights, slopes) in trend_rows(model).items():
            for p, references in tested.items():
                # A line ends where the study ends.
                at = np.geomspace(references.min(), references.max(), _POINTS)
                decades = np.log10(at) - np.log10(references).mean()
                rows = heights[p] + np.multiply.outer(decades, slopes[p])
                where = (statistics.parameters[p], condition, len(statistics.subjects))
                yield from _line(fit, model.moments(points, rows), at, where)


def _what(fit: Fit, parameter: str) -> str:
    return f"line of {fit.data.quantities[parameter].label} over the reference"


def _why_not(references: list[float]) -> str:
    """Say why references have no line; empty where they have."""
    if min(references) <= 0.0:
        return "a reference of zero or below has no logarithm"
    count = len(set(references))
    if count < _FEWEST_REFERENCES:
        return f"it needs {_FEWEST_REFERENCES} different references, and there are {count}"
    return ""


def _line(
    fit: Fit,
    laws: Moments,
    at: Array,
    where: tuple[str, str, int],
) -> Iterator[PseLineRow | Skipped]:
    """Yield a row for each reference, from the laws of responses there.

    `where` is the quantity, the condition and the number of subjects.
    """
    asked = fit.data.asked
    parameter, condition, subjects = where
    limits_at = DrawLimits(asked.level, effective=len(laws.mean)).of_laws(laws)
    # In half-widths.
    worst = max(2.0 * (own.error or 0.0) / (own.upper - own.lower) for own in limits_at)
    if worst > _MOST_TOLERANCES * asked.tolerance:
        why = f"the Monte Carlo error of its limits is {worst:.0%} of a half-width"
        yield Skipped(_what(fit, parameter), why)
        return
    scale = ResponseScale.of(at, asked.family)
    for index, (reference, limits) in enumerate(zip(at.tolist(), limits_at, strict=True)):
        yield PseLineRow(
            parameter=parameter,
            condition=condition,
            method="bayesian",
            family=asked.family,
            level=asked.level,
            reference=reference,
            **vars(mapped(limits, scale.at(index).native)),
            unit=fit.data.quantities[parameter].unit,
            n=subjects,
        )
