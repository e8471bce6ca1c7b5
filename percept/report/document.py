"""The sections of a page, in reading order."""

from __future__ import annotations

from percept.report.bias import bias
from percept.report.boundaries import boundaries, comparison
from percept.report.checks import checks
from percept.report.data import data
from percept.report.display import display
from percept.report.methods import methods
from percept.report.overview import summary
from percept.report.sections import Section
from percept.results import Findings, Results

__all__ = ["build_sections"]


def build_sections(results: Results, found: Findings) -> list[Section]:
    """Return the answer, the methods against each other, and what is folded."""
    return [
        summary(results, found),
        comparison(results),
        bias(results),
        boundaries(results),
        display(results),
        checks(results, found.overview.rows),
        data(results),
        methods(results, found.paragraph),
    ]
