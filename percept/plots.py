"""Plots of a study on matplotlib axes of one's own: what the report draws, from Python."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.report.figures.canvas import COLOURS
from percept.report.figures.curves import draw_magnitude, draw_stability, like_limits, reference_of
from percept.report.figures.from_document import (
    axis_of_bars,
    band_series,
    bars_of,
    values_of,
)
from percept.report.figures.marks import draw_band, draw_intervals
from percept.report.select import (
    Record,
    array,
    compared_by_difference,
    each_by_itself,
    families_of,
    kind_names,
    quantities_of,
)
from percept.results import Coupling, SubjectCheck

# Names are the user's: a dollar sign among them begins no formula.
_STYLE: Any = {"text.parse_math": False, "axes.formatter.use_mathtext": False}
#: Level of the band that ordered probabilities lie in.
_LEVEL = 0.99


def plot_intervals(
    document: Record, parameters: Sequence[str], kinds: Sequence[str], ax: Axes | None
) -> Axes:
    """Draw a row per environment, of several quantities a row per quantity and environment."""
    quantities, log = quantities_of(document), families_of(document)[0] == "lognormal"
    differences = compared_by_difference(document["intervals"]).intersection(parameters)
    if differences and len(parameters) > 1:
        raise UsageError(
            "quantities with a reference of zero or below are drawn one at a time.",
            hint=f"Name one of {', '.join(parameters)}.",
        )
    rows, bars, values = [], [], []
    for name in parameters:
        for environment in document["data"]["environments"]:
            label = (
                environment if len(parameters) == 1 else f"{environment}, {quantities[name].label}"
            )
            rows.append(label)
            values.append(values_of(document, environment, name))
            bars += [
                dataclasses.replace(bar, environment=label)
                for bar in bars_of(document, name, kinds)
                if bar.environment == environment
            ]
    if not bars:
        raise _nothing("interval that has a reference")
    with rc_context(_STYLE):
        ax = _axes(ax)
        relative = not differences
        draw_intervals(
            ax,
            rows,
            bars,
            values,
            log=log and relative,
            subject=document["data"]["words"]["subject"][0],
            names=kind_names(document),
            centre=1.0 if relative else 0.0,
        )
        quantity = quantities[parameters[0]]
        words = quantity.words if len(parameters) == 1 else "value"
        ax.set_xlabel(axis_of_bars(f"adjusted {words}", quantity, relative=relative))
        for tick in ax.get_yticklabels():
            tick.set_parse_math(False)  # of axes that were there before, the ticks were too
        # Rows fill the axes: there is no room for a legend inside.
        return _legend(ax, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def plot_boundary(document: Record, environment: str, kind: str, ax: Axes | None) -> Axes:
    """Draw the boundaries of both methods in one family and shape, with the reference."""
    if not document["boundaries"]:
        raise _nothing("boundary")
    rows = [row for row in document["boundaries"] if each_by_itself(row)]
    limits = like_limits(rows, kind, families_of(document))
    if not limits:
        raise _nothing(f"boundary of kind {kind} around {environment}")
    with rc_context(_STYLE):
        ax = _axes(ax)
        draw_magnitude(ax, array(rows[0]["omega"]), limits, *reference_of(rows[0]))
        ax.set_title(f"{environment}, kind {kind}")
        return _legend(ax)


def plot_band(document: Record, parameter: str | None, ax: Axes | None) -> Axes:
    """Draw bands and their laws."""
    band = document["band"]
    if not band or not band["rows"]:
        raise _nothing("band")
    there = list(dict.fromkeys(row.get("parameter") for row in band["rows"]))
    if parameter is not None and parameter not in there:
        raise UsageError(
            "there is no band of it.", value=parameter, hint="A band of impedance has no parameter."
        )
    kind, grid, series, words = band_series(document, parameter or there[0])
    with rc_context(_STYLE):
        ax = _axes(ax)
        draw_band(ax, grid, series, **words)
        ax.set_title(f"kind {kind}")
        return _legend(ax)


def plot_coupling(coupling: Coupling | None, ax: Axes | None) -> Axes:
    """Draw the criterion's bound, the coupling's admittance, and where it binds."""
    if coupling is None:
        raise _nothing("coupling to plot")
    with rc_context(_STYLE):
        ax = _axes(ax)
        drawn = {"this coupling": (coupling.admittance, coupling.binding_omega)}
        draw_stability(ax, coupling.omega, coupling.bound, drawn)
        ax.set_title(f"{coupling.verdict}, margin {coupling.margin:.3g}")
        return ax


def plot_check(subjects: Sequence[SubjectCheck], ax: Axes | None) -> Axes:
    """Draw the ordered probabilities of lying as far off against a uniform law's."""
    if not subjects:
        raise _nothing("check of a hierarchical model")
    subjects = sorted(subjects, key=lambda subject: subject.farther)
    count, rank = len(subjects), np.arange(1, len(subjects) + 1)
    # The order statistics of independent uniform numbers have Beta laws.
    low, high = (
        stats.beta.ppf((1 + side * _LEVEL) / 2, rank, count + 1 - rank) for side in (-1, 1)
    )
    expected = rank / (count + 1)
    with rc_context(_STYLE):
        ax = _axes(ax)
        ax.fill_between(
            expected,
            low,
            high,
            color=COLOURS["quiet"],
            alpha=0.2,
            linewidth=0,
            label=f"{_LEVEL:.0%}",
        )
        ax.plot([0, 1], [0, 1], color=COLOURS["ink"], linestyle=(0, (7, 3)), linewidth=0.8)
        ax.plot(
            expected,
            [subject.farther for subject in subjects],
            marker="D",
            linestyle="none",
            color=COLOURS["bayesian"],
            label="subjects",
        )
        for x, subject in zip(expected, subjects, strict=True):
            if subject.outlier:
                point = (x, subject.farther)
                ax.annotate(subject.subject, point, xytext=(4, 0), textcoords="offset points")
        ax.set_xlabel("expected probability")
        ax.set_ylabel("probability of lying as far off")
        return _legend(ax)


def _nothing(what: str) -> RefusalError:
    return RefusalError(f"the study has no {what}.", hint="study.skipped says why.")


def _axes(ax: Axes | None) -> Axes:
    return plt.subplots(layout="constrained")[1] if ax is None else ax


def _legend(ax: Axes, **place: Any) -> Axes:
    """Add a legend that has each label once."""
    named = dict(zip(*ax.get_legend_handles_labels()[::-1], strict=True))
    ax.legend(named.values(), named.keys(), frameon=False, fontsize="small", **place)
    return ax
