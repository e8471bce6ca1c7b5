"""The figures of intervals that a document gives."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import Drawing, Figure, legend_below, panels, row_labels
from percept.report.figures.intervals import Bar, draw_intervals
from percept.report.select import KINDS, METHODS, array, distinct, family_of, first, matching

FloatArray = NDArray[np.float64]
_NAMES = {"k": "stiffness k", "b": "damping b"}
_BARS = {
    "mean": "average user (thick bar, mark at the estimate)",
    "user": "next user",
    "share": "share of users (thin)",
}
# Left margin, mm: at least that of short names, at most what leaves the bars more than half of the width.
_LEAST_MARGIN, _MOST_MARGIN = 18.0, 52.0
# Between a label and the axis, and to the edge of the figure, mm; other viewers' lettering may be wider.
_MARGIN_BESIDE = 4.0


def interval_drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return one figure per parameter: every kind and method in the study's family, over the reference."""
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
                _description(rows, bars, values, family),
                (130.0, 26.0 + 17.0 * len(environments)),
                partial(_draw, name, environments, bars, values, family == "lognormal"),
            )
        )
    return found


def _description(rows: list[Any], bars: list[Bar], values: list[FloatArray], family: str) -> str:
    kinds = [text for kind, text in _BARS.items() if any(bar.kind == kind for bar in bars)]
    order = "In each environment from top to bottom: " + ", ".join(kinds)
    if len({bar.method for bar in bars}) == 2:
        order += "; each classical above Bayesian"
    if any(seen.size for seen in values):
        order += "; below them the subjects"
    empty = distinct([row for row in rows if row["reference"] == 0], "environment")
    left_out = f" Only in the tables, since their reference is 0: {', '.join(empty)}." if empty else ""
    return f"{order}. The dashed line is the reference.{_classical(rows, family)}{left_out}"


def _classical(rows: list[Any], family: str) -> str:
    """Say of which family the classical limits are: they are worked out in both."""
    classical = [row for row in rows if row["method"] == "classical"]
    shown = {row["environment"]: row["family"] for row in classical}
    shown |= {row["environment"]: family for row in classical if row["family"] == family}
    drawn = [name for name in (family, "lognormal", "normal") if name in shown.values()]
    return f" Classical limits are {', where there are none '.join(dict.fromkeys(drawn))}." if drawn else ""


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
    labels, width = row_labels(environments, most=_MOST_MARGIN - _MARGIN_BESIDE)
    (ax,) = panels(figure, left=max(_LEAST_MARGIN, width + _MARGIN_BESIDE), top=3, bottom=21)
    draw_intervals(ax, environments, bars, values, log=log, labels=labels)
    ax.set_xlabel(f"adjusted {name} / reference")
    legend_below(ax, columns=4)
