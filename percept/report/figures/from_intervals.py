"""The figures of intervals that a document gives."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import Drawing, Figure, legend_below, panels
from percept.report.figures.intervals import Bar, draw_intervals
from percept.report.select import KINDS, METHODS, array, distinct, family_of, first, matching

__all__ = ["interval_drawings"]

FloatArray = NDArray[np.float64]
_NAMES = {"k": "stiffness k", "b": "damping b"}


def interval_drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return one figure per parameter: every kind and method in the study's family, over the reference.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    list of Drawing
        None for a parameter whose references are zero.
    """
    family = family_of(document)
    found = []
    for parameter in distinct(document["intervals"], "parameter"):
        rows = matching(document["intervals"], parameter=parameter, joint="marginal")
        environments = distinct(rows, "environment")
        bars = [
            bar
            for environment in environments
            for kind in KINDS
            for method in METHODS
            if (bar := _bar(rows, environment, kind, method, family)) is not None
        ]
        if not bars:
            continue
        values = [_values(document, environment, parameter) for environment in environments]
        name = _NAMES[parameter]
        found.append(
            Drawing(
                f"intervals_{parameter}",
                f"Intervals of {name}, divided by the reference",
                "In each environment from top to bottom: average user (thick bar, mark at the estimate), "
                "next user, share of users (thin); each classical above Bayesian, and below them the "
                "subjects. The dashed line is the reference.",
                (130.0, 26.0 + 17.0 * len(environments)),
                partial(_draw, name, environments, bars, values, family == "lognormal"),
            )
        )
    return found


def _bar(rows: list[Any], environment: str, kind: str, method: str, family: str) -> Bar | None:
    row = first(
        matching(rows, environment=environment, kind=kind, method=method),
        family=(family, "lognormal", "normal"),
    )
    if row is None or not row.get("reference") or row["lower"] is None or row["upper"] is None:
        return None
    lower, upper, estimate = (float(row[name]) / row["reference"] for name in ("lower", "upper", "estimate"))
    return Bar(environment, kind, method, lower, upper, estimate)


def _values(document: Mapping[str, Any], environment: str, parameter: str) -> FloatArray:
    cells = matching(document["data"]["cells"], environment=environment, parameter=parameter)
    if not cells or not cells[0]["reference"]:
        return np.empty(0)
    return array(cells[0]["values"]) / cells[0]["reference"]


def _draw(
    name: str,
    environments: list[str],
    bars: list[Bar],
    values: list[FloatArray],
    log: bool,
    figure: Figure,
) -> None:
    (ax,) = panels(figure, left=18, top=3, bottom=21)
    draw_intervals(ax, environments, bars, values, log=log)
    ax.set_xlabel(f"adjusted {name} / reference")
    legend_below(ax, columns=4)
