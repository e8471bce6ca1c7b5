"""Plots on matplotlib axes of one's own: what the report draws, from Python.

Every plot draws on `ax`, or on a new figure without one, and returns the axes. It raises
RefusalError where there is nothing to plot.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.report.figures.band import band_series, draw_band
from percept.report.figures.boundaries import like_limits
from percept.report.figures.canvas import COLOURS, REFERENCE_DASHES
from percept.report.figures.curves import draw_magnitude, draw_stability
from percept.report.figures.intervals import (
    Bar,
    BarAxis,
    bars_of,
    draw_intervals,
)
from percept.report.figures.people import draw_subjects, subjects_of
from percept.report.select import (
    compared_by_difference,
    distinct,
    each_by_itself,
    kind_names,
    matching,
    preferred_families,
)
from percept.results import Band, Boundary, Coupling, Data, IntervalRow, SubjectCheck

__all__ = ["plot_band", "plot_boundary", "plot_check", "plot_coupling", "plot_intervals"]

# Names are the user's: a dollar sign among them begins no formula.
_STYLE: dict[Any, Any] = {"text.parse_math": False, "axes.formatter.use_mathtext": False}
#: In widths of the axes: counts of subjects beyond the axis stand between.
_BESIDE_COUNTS = 1.06
#: Probability that each ordered probability of independent subjects lies in the band of a check.
_LEVEL = 0.99


def plot_intervals(
    intervals: Sequence[IntervalRow],
    data: Data,
    *,
    parameters: Collection[str],
    kinds: Collection[str],
    family: str,
    ax: Axes | None = None,
) -> Axes:
    """Draw a row per environment, of several quantities a row per quantity and environment.

    Parameters
    ----------
    intervals : sequence of IntervalRow
        Of every method and family.
    data : Data
        What was read, with the values of the subjects.
    parameters, kinds : collection of str
        What is drawn.
    family : str
        The family drawn where there is a choice.
    ax : Axes, optional
        To draw on.

    Returns
    -------
    Axes

    Raises
    ------
    UsageError
        Several quantities of which one has a reference of zero or below.
    RefusalError
        No interval has a reference.
    """
    several = len(parameters) > 1
    differences = compared_by_difference(intervals).intersection(parameters)
    if differences and several:
        raise UsageError(
            "quantities with a reference of zero or below are drawn one at a time.",
            hint=f"Name one of {', '.join(parameters)}.",
        )
    rows: list[str] = []
    bars: list[Bar] = []
    subjects = []
    for parameter in parameters:
        of_parameter = bars_of(intervals, parameter, kinds, preferred_families(family))
        for environment in data.environments:
            row = environment
            if several:
                row = f"{environment}, {data.quantities[parameter].label}"
            rows.append(row)
            subjects.append(subjects_of(data.cells, environment, parameter))
            for bar in matching(of_parameter, environment=environment):
                bars.append(dataclasses.replace(bar, environment=row))
    if not bars:
        raise _nothing("interval that has a reference")
    axis = BarAxis(relative=not differences, log=family == "lognormal")
    quantity = data.quantities[next(iter(parameters))]
    words = "value" if several else quantity.words
    with rc_context(_STYLE):
        ax = _axes(ax)
        draw_intervals(ax, rows, bars, axis, kinds=kind_names(data.words))
        draw_subjects(ax, subjects, subject=data.words.subject[0])
        ax.set_xlabel(axis.label(f"adjusted {words}", quantity))
        for tick in ax.get_yticklabels():
            tick.set_parse_math(False)  # of axes that were there before, the ticks were too
        # Rows fill the axes: there is no room for a legend inside.
        return _legend(ax, loc="upper left", bbox_to_anchor=(_BESIDE_COUNTS, 1.0))


def plot_boundary(
    boundaries: Sequence[Boundary],
    environment: str,
    kind: str,
    *,
    family: str,
    ax: Axes | None = None,
) -> Axes:
    """Draw the boundaries of both methods in one family and shape, with the reference.

    Parameters
    ----------
    boundaries : sequence of Boundary
        Of every environment, kind and method.
    environment, kind : str
        What is drawn.
    family : str
        The family drawn where there is a choice.
    ax : Axes, optional
        To draw on.

    Returns
    -------
    Axes
        abs(Z_h), N·s/m, over omega, rad/s.

    Raises
    ------
    RefusalError
        There is no such boundary.
    """
    if not boundaries:
        raise _nothing("boundary")
    main = [boundary for boundary in boundaries if each_by_itself(boundary)]
    of_environment = matching(main, environment=environment)
    limits = like_limits(of_environment, kind, preferred_families(family))
    if not limits:
        raise _nothing(f"boundary of kind {kind} around {environment}")
    shown = of_environment[0]
    with rc_context(_STYLE):
        ax = _axes(ax)
        draw_magnitude(ax, shown.omega, limits, shown.reference, shown.coupled)
        ax.set_title(f"{environment}, kind {kind}")
        return _legend(ax)


def plot_band(
    band: Band | None,
    data: Data,
    parameter: str | None = None,
    *,
    family: str,
    ax: Axes | None = None,
) -> Axes:
    """Draw bands and their laws, against the environment's impedance or a parameter's reference.

    Parameters
    ----------
    band : Band or None
        The bands.
    data : Data
        What was read.
    parameter : str, optional
        Whose band; None for that of the impedance, or of the first quantity where there is none.
    family : str
        The family drawn where there is a choice.
    ax : Axes, optional
        To draw on.

    Returns
    -------
    Axes

    Raises
    ------
    UsageError
        A parameter without a band.
    RefusalError
        There is no band.
    """
    if band is None or not band.rows:
        raise _nothing("band")
    parameters = distinct(band.rows, "parameter")
    if parameter is not None and parameter not in parameters:
        raise UsageError(
            "there is no band of it.", value=parameter, hint="A band of impedance has no parameter."
        )
    families = preferred_families(family)
    series = band_series(band, parameter or parameters[0], families, data.quantities)
    with rc_context(_STYLE):
        ax = _axes(ax)
        draw_band(ax, series)
        ax.set_title("next user")
        return _legend(ax)


def plot_coupling(coupling: Coupling | None, *, ax: Axes | None = None) -> Axes:
    """Draw Eq. 10's bound, the coupling's admittance, m/(N·s), and where it binds, rad/s."""
    if coupling is None:
        raise _nothing("coupling to plot")
    with rc_context(_STYLE):
        ax = _axes(ax)
        lines = {"this coupling": (coupling.admittance, coupling.eq10_omega)}
        draw_stability(ax, coupling.omega, coupling.bound, lines)
        ax.set_title(f"Eq. 10 is {coupling.eq10}, margin {coupling.eq10_margin:.3g}")
        _restyle(ax)
        return ax


def plot_check(subjects: Sequence[SubjectCheck] | None, *, ax: Axes | None = None) -> Axes:
    """Draw the ordered probabilities of lying as far off against a uniform law's."""
    if not subjects:
        raise _nothing("check of a hierarchical model")
    ordered = sorted(subjects, key=lambda subject: subject.farther)
    count = len(ordered)
    rank = np.arange(1, count + 1)
    # The order statistics of independent uniform numbers have Beta laws.
    low = stats.beta.ppf((1 - _LEVEL) / 2, rank, count + 1 - rank)
    high = stats.beta.ppf((1 + _LEVEL) / 2, rank, count + 1 - rank)
    expected = rank / (count + 1)
    with rc_context(_STYLE):
        ax = _axes(ax)
        quiet = COLOURS["quiet"]
        label = f"{_LEVEL:.0%}"
        ax.fill_between(expected, low, high, color=quiet, alpha=0.2, linewidth=0, label=label)
        ink = COLOURS["ink"]
        ax.plot([0, 1], [0, 1], color=ink, linestyle=REFERENCE_DASHES, linewidth=0.8)
        farther = [subject.farther for subject in ordered]
        ax.plot(expected, farther, "D", color=COLOURS["bayesian"], label="subjects")
        for x, subject in zip(expected, ordered, strict=True):
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
    """Take on the style's colours, and add a legend that has each label once."""
    _restyle(ax)
    handles, labels = ax.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    ax.legend(named.values(), named.keys(), frameon=False, fontsize="small", **place)
    return ax


def _restyle(ax: Axes) -> None:
    """Draw what is ink, quiet or paper in a report in the colours of the reader's style."""
    paper = rcParams["axes.facecolor"]
    colours = {
        COLOURS["ink"]: rcParams["text.color"],
        COLOURS["quiet"]: rcParams["axes.labelcolor"],
        COLOURS["paper"]: paper,
    }
    for line in ax.get_lines():
        line.set_color(colours.get(to_hex(line.get_color()), line.get_color()))
        face = line.get_markerfacecolor()
        # An automatic face follows the line's colour; it is no colour of its own.
        if face in colours:
            line.set_markerfacecolor(colours[face])
    for text in ax.texts:
        ground = text.get_bbox_patch()
        if ground is not None:
            ground.set_facecolor(paper)
