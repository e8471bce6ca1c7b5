"""Plots on matplotlib axes of one's own: what the report draws, from Python.

Every plot draws on `ax`, or on a new figure without one, and returns the axes. A legend is drawn on
new figures alone. It raises RefusalError where there is nothing to plot.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from itertools import product
from typing import Any

import matplotlib.pyplot as plt
from matplotlib import rc_context, rcParams
from matplotlib.axes import Axes

from percept.errors import RefusalError, UsageError
from percept.report.basics import (
    METHODS,
    bracketed,
    distinct,
    families_from,
    matching,
    unwidened,
)
from percept.report.biases import biases_among
from percept.report.figures.boundaries import alike_boundaries, draw_band, draw_magnitude
from percept.report.figures.canvas import COLOURS
from percept.report.figures.couplings import draw_stability
from percept.report.figures.intervals import draw_intervals
from percept.results import Band, Boundary, Coupling, Data, IntervalRow

# Names are the user's: a dollar sign among them begins no formula.
_STYLE: dict[Any, Any] = {"text.parse_math": False, "axes.formatter.use_mathtext": False}


def plot_intervals(
    intervals: Sequence[IntervalRow],
    data: Data,
    *,
    parameter: str,
    kinds: Collection[str],
    family: str,
    ax: Axes | None = None,
) -> Axes:
    """Draw a row per environment: subjects as dots, intervals of both methods as bars.

    Parameters
    ----------
    intervals : sequence of IntervalRow
        Of every method and family.
    data : Data
        What was read, with the values of the subjects.
    parameter : str
        The quantity.
    kinds : collection of str
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
    RefusalError
        No interval has a reference.
    """
    quantity = data.quantities[parameter]
    biases = []
    for kind, method in product(kinds, METHODS):
        rows = matching(unwidened(intervals), parameter=parameter, kind=kind, method=method)
        biases += biases_among(rows, {parameter: quantity}, families_from(family))
    if not biases:
        raise _nothing("interval that has a reference")
    return _plotted(ax, quantity.head, draw_intervals, biases, data.cells, quantity, data.words)


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
    of_environment = matching(unwidened(boundaries), environment=environment)
    curves = alike_boundaries(of_environment, kind, families_from(family))
    if not curves:
        raise _nothing(f"boundary of kind {kind} around {environment}")
    return _plotted(ax, f"|Zₕ| of {environment} (N·s/m), kind {kind}", draw_magnitude, curves)


def plot_band(
    band: Band | None,
    data: Data,
    parameter: str | None = None,
    *,
    family: str,
    ax: Axes | None = None,
) -> Axes:
    """Draw bands and their law, against the environment's impedance or a parameter's reference.

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
    shown = parameter or parameters[0]
    what = "|Zₑ| (N·s/m)"
    if shown is not None:
        quantity = data.quantities[shown]
        what = quantity.words + bracketed(quantity.unit)
    title = f"Band of {what}, next {data.words.user}"
    return _plotted(ax, title, draw_band, band, shown, families_from(family), data.quantities)


def plot_coupling(coupling: Coupling | None, *, ax: Axes | None = None) -> Axes:
    """Draw Eq. 10's bound, the coupling's admittance, m/(N·s), and where it binds, rad/s."""
    if coupling is None:
        raise _nothing("coupling to plot")
    title = f"Eq. 10 is {coupling.eq10}, margin {coupling.eq10_margin:.3g}"
    return _plotted(ax, title, draw_stability, coupling)


def _nothing(what: str) -> RefusalError:
    return RefusalError(f"the study has no {what}.", hint="study.skipped says why.")


def _plotted(ax: Axes | None, title: str, draw: Callable[..., None], *what: Any) -> Axes:
    """Draw on axes, or on a new figure with a legend, in the reader's colour of text."""
    with rc_context(_STYLE):
        drawn = plt.subplots(layout="constrained")[1] if ax is None else ax
        draw(drawn, *what)
        drawn.set_title(title)
        for tick in drawn.get_yticklabels():
            tick.set_parse_math(False)  # of axes that were there before, the ticks were too
        for line in drawn.get_lines():
            if line.get_color() == COLOURS["ink"]:
                line.set_color(rcParams["text.color"])
        if ax is None:
            handles, labels = drawn.get_legend_handles_labels()
            named = dict(zip(labels, handles, strict=True))
            drawn.legend(named.values(), named.keys(), frameon=False, fontsize="small")
        return drawn
