"""The page of an identified device: parameters, response, residuals and coherence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from percept.identify.result import Identified
from percept.provenance import Made
from percept.report.figures.canvas import COLOURS, WIDE, Drawing, Frame, log_scale, panels
from percept.report.figures.output import drawn
from percept.report.page import render_standalone

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["render_identified"]

_HEIGHT = 130.0  # mm
_MEASURED = COLOURS["classical"]
_FITTED = COLOURS["bayesian"]
_RESIDUAL_LIMIT = 1.96  # SDs of a real part that 95 % of normal noise keep


def render_identified(found: Identified, name: str, made: Made) -> str:
    """Render the page.

    Parameters
    ----------
    found : Identified
        The device.
    name : str
        Of the log's file.
    made : Made
        What the page is made by.

    Returns
    -------
    str
        HTML that needs nothing else.
    """

    def draw(figure: Figure) -> None:
        _draw(figure, found)

    drawing = Drawing(
        name="response",
        title="Response of the device, measured and fitted",
        description="Magnitude, phase, residuals and coherence over frequency. Dots are measured,"
        " lines are fitted. Residuals of a device that fits lie between the dashed lines at 95 % of"
        " the frequencies.",
        size=(WIDE, _HEIGHT),
        draw=draw,
    )
    _, svg = drawn(drawing, ())
    return render_standalone(
        "percept.identify", "identified.html.j2", {}, digits=5,
        found=found, name=name, made=made, svg=svg, drawing=drawing,
    )  # fmt: skip


def _draw(figure: Figure, found: Identified) -> None:
    """Draw four panels over frequency."""
    magnitude, phase, residual, coherence = panels(
        figure, 4, columns=2, frame=Frame(left=16.0, gap=18.0)
    )
    omega = found.omega
    magnitude.plot(omega, np.abs(found.measured), ".", color=_MEASURED, label="measured")
    magnitude.plot(omega, np.abs(found.fitted), color=_FITTED, label="fitted")
    magnitude.set_title("Magnitude (N·s/m)")
    magnitude.legend()
    log_scale(magnitude)
    phase.plot(omega, np.rad2deg(np.unwrap(np.angle(found.measured))), ".", color=_MEASURED)
    phase.plot(omega, np.rad2deg(np.unwrap(np.angle(found.fitted))), color=_FITTED)
    phase.set_title("Phase (deg)")
    residual.plot(omega, np.sqrt(2.0) * found.residuals.real, ".", color=_MEASURED)
    for limit in (-_RESIDUAL_LIMIT, _RESIDUAL_LIMIT):
        residual.axhline(limit, color=COLOURS["quiet"], linestyle="--", linewidth=0.6)
    residual.set_title("Residual, real part (SDs of its noise)")
    coherence.plot(omega, found.coherence, ".", color=_MEASURED)
    coherence.set_title("Coherence")
    coherence.set_ylim(0.0, 1.02)
    for axes in (phase, residual, coherence):
        log_scale(axes, "x")
    for axes in (residual, coherence):
        axes.set_xlabel("ω (rad/s)")
