"""Curves over the angular frequency: boundaries, close views, and boundaries over the reference."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from percept.report.biases import drawn_said, foremost
from percept.report.decisions import FEELINGS
from percept.report.figures.canvas import (
    COLOURS,
    REFERENCE_DASHES,
    Drawing,
    legend,
    log_scale,
    panels,
    shortened,
)
from percept.report.select import (
    METHOD_NAMES,
    METHODS,
    distinct,
    families_from,
    family_of,
    first,
    is_rendered,
    matching,
    present,
    unwidened,
)
from percept.results import Boundary, Results

FloatArray = NDArray[np.float64]

_COUPLED_DASHES = (0, (2.5, 1.5))
# Long and short dashes as in the paper's Fig. 4; more couplings go on with other patterns.
_COUPLING_COLOURS = ("classical", "bayesian", "coupled", "warn")
_COUPLING_DASHES = ((0, (9, 3)), (0, (3, 2)), (0, (6, 2, 1, 2)), (0, (1, 1.5)))
#: The next user's boundary is what the paper's rule asks about.
_WHOM = {
    "user": "the next {0.user}",
    "mean": "the average {0.user}",
    "share": "a share of all {0.users}",
}
#: Shapes that both methods have, the exact one first.
_SHAPES = ("envelope", "pointwise")
_COLUMNS = 3  # panels side by side
_PANEL_HEIGHT = 42.0  # mm, with its labels
_LEGEND_HEIGHT = 12.0  # mm
_TITLE = 18  # letters
_VERDICT = 11  # letters in a line


@dataclass(frozen=True, eq=False)
class Limits:
    """A pair of curves to draw.

    Parameters
    ----------
    label : str
        For the legend.
    method : str
        Decides colour and form: classical limits are lines, Bayesian ones a filled band.
    omega : ndarray, shape (n,)
        rad/s.
    lower, upper : ndarray, shape (n,)
        N·s/m.
    reference : ndarray, shape (n,)
        abs(Z_h) of the reference at the same frequencies, N·s/m.
    """

    label: str
    method: str
    omega: FloatArray
    lower: FloatArray
    upper: FloatArray
    reference: FloatArray

    @property
    def over_reference(self) -> Limits:
        """The same curves divided by the reference."""
        return replace(self, lower=self.lower / self.reference, upper=self.upper / self.reference)


def draw_magnitude(
    ax: Axes,
    omega: FloatArray,
    limits: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None = None,
    *,
    log: bool = True,
) -> None:
    """Draw boundaries, the reference and the coupled impedance, in the manner of Fig. 7.

    Parameters
    ----------
    ax : Axes
        To draw on.
    omega : ndarray, shape (n,)
        Frequencies of `reference` and `coupled`, rad/s.
    limits : sequence of Limits
        The boundaries.
    reference, coupled : ndarray, shape (n,)
        abs(Z_h), directly and through the coupling, N·s/m.
    log : bool
        Whether both axes are logarithmic.
    """
    for pair in limits:
        colour = COLOURS[pair.method]
        if pair.method == "classical":
            ax.plot(pair.omega, pair.lower, color=colour, label=pair.label)
            ax.plot(pair.omega, pair.upper, color=colour)
            continue
        # The corner curves cross; the band between them is what is meant.
        low = np.minimum(pair.lower, pair.upper)
        high = np.maximum(pair.lower, pair.upper)
        ax.fill_between(
            pair.omega, low, high, color=colour, alpha=0.25, linewidth=0, label=pair.label
        )
        ax.plot(pair.omega, low, color=colour, linewidth=0.6)
        ax.plot(pair.omega, high, color=colour, linewidth=0.6)
    ax.plot(omega, reference, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, label="reference")
    if coupled is not None:
        label = "through the coupling"
        ax.plot(omega, coupled, color=COLOURS["coupled"], linestyle=_COUPLED_DASHES, label=label)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("|Zₕ| (N·s/m)")
    if log:
        log_scale(ax, "x", plain=True)
        log_scale(ax, "y")
    else:
        ax.locator_params(nbins=3)


def _draw_ratio(ax: Axes, shown: Boundary, limits: Sequence[Limits]) -> None:
    """Draw boundaries and the coupled impedance over the reference, on an axis that holds them."""
    reference = shown.reference
    coupled = None if shown.coupled is None else shown.coupled / reference
    ratios = [pair.over_reference for pair in limits]
    draw_magnitude(ax, shown.omega, ratios, np.ones_like(reference), coupled)
    log_scale(ax, "y", plain=True)
    ax.set_ylabel("|Zₕ| / reference’s |Zₕ|")


def draw_stability(
    ax: Axes,
    omega: ArrayLike,
    bound: ArrayLike,
    couplings: Mapping[str, tuple[ArrayLike, float]],
) -> None:
    """Draw the bound of Eq. 10, and couplings that have to stay above it.

    Parameters
    ----------
    ax : Axes
        To draw on.
    omega : array_like, shape (n,)
        rad/s.
    bound : array_like, shape (n,)
        The least real part of a coupling's admittance, m/(N·s).
    couplings : mapping of str to (array_like, float)
        By label: the real part of the admittance, m/(N·s), and the frequency where it binds, rad/s.
    """
    omega = np.asarray(omega, dtype=float)
    drawn_bound = _positive(bound)
    ax.plot(
        omega, drawn_bound, color=COLOURS["ink"], linewidth=1.4, label="lower bound (Eq. 10)",
        gid="bound",
    )  # fmt: skip
    styles = zip(cycle(_COUPLING_DASHES), cycle(_COUPLING_COLOURS), strict=False)
    for (label, (values, binding)), (dashes, name) in zip(couplings.items(), styles, strict=False):
        curve = _positive(values)
        colour = COLOURS[name]
        (line,) = ax.plot(
            omega, curve, label=label, gid=f"coupling:{label}", color=colour, linestyle=dashes,
            linewidth=1.4,
        )  # fmt: skip
        if omega[0] <= binding <= omega[-1]:
            reached = _at(binding, omega, curve)
            needed = _at(binding, omega, drawn_bound)
            ax.plot([binding], [reached], "o", markersize=5, color=colour, gid=f"binding:{label}")
            # In the legend, because the marks of like couplings lie on top of each other.
            line.set_label(f"{label}: {reached / needed:.3g} × bound at {binding:.4g} rad/s")
    log_scale(ax)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("admittance, real part (m/(N·s))")


def _positive(values: ArrayLike) -> FloatArray:
    """Return a curve with gaps where it is zero or infinite: these have no logarithm."""
    curve = np.asarray(values, dtype=float)
    return np.where((curve > 0) & np.isfinite(curve), curve, np.nan)


def _at(frequency: float, omega: FloatArray, values: FloatArray) -> float:
    """Return a curve's value between its points, straight on the log-log axes."""
    known = np.isfinite(values)
    logs = np.interp(np.log(frequency), np.log(omega[known]), np.log(values[known]))
    return float(np.exp(logs))


def curve_drawings(results: Results) -> list[Drawing]:
    """Return boundaries over the reference with the verdicts, and the scene's close views."""
    shown = foremost(results)
    main = [record for record in unwidened(results.boundaries) if record.environment in shown]
    if not main:
        return []
    kind = present(_WHOM, main, "kind")[0]
    whom = _WHOM[kind].format(results.data.words)
    said = "Bands: Bayesian; lines: classical. Dashed: the reference"
    if main[0].coupled is not None:
        said += "; short dashes: the reference through the coupling"
    close = matching(results.close, kind=kind)
    drawings = [
        Drawing(
            name="ratios",
            title=f"What {whom} takes for the reference, over the reference’s |Z_h|",
            description=f"{said}. {drawn_said(results)}".rstrip(),
            height=_height(distinct(main, "environment")),
            draw=partial(_draw, results=results, boundaries=main, kind=kind),
        )
    ]
    if close:
        drawings.append(
            Drawing(
                name="boundaries_close",
                title=f"Boundaries of |Z_h| for {whom}, close views",
                description=f"{said}.",
                height=_height(distinct(close, "environment")),
                draw=partial(_draw, results=results, boundaries=close, kind=kind),
            )
        )
    return drawings


def _height(names: Sequence[str]) -> float:
    rows = -(-len(names) // _COLUMNS)
    return _LEGEND_HEIGHT + _PANEL_HEIGHT * rows


def _draw(figure: Figure, results: Results, boundaries: Sequence[Boundary], kind: str) -> None:
    """Draw a panel per environment, each on axes of its own; close views as they are."""
    names = distinct(boundaries, "environment")
    axes = panels(figure, len(names), columns=min(len(names), _COLUMNS))
    titles = shortened(names, _TITLE)
    families = families_from(family_of(results))
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        own = matching(boundaries, environment=name)
        limits = like_limits(own, kind, families)
        if own[0] in results.close:
            draw_magnitude(ax, own[0].omega, limits, own[0].reference, own[0].coupled, log=False)
            ax.set_title(titles[index])
        else:
            _draw_ratio(ax, own[0], limits)
            # A panel is some 20 mm wide.
            verdict = textwrap.fill(_verdict(results, name), _VERDICT)
            ax.set_title(f"{titles[index]}\n{verdict}".strip(), fontsize="medium")
        if index % _COLUMNS:
            ax.set_ylabel("")
    legend(axes, ncols=2)


def _verdict(results: Results, name: str) -> str:
    """Return the verdict on the display, through the coupling where there is one."""
    coupled = bool(matching(results.verdicts, coupled=True))
    verdict = first(matching(results.verdicts, environment=name, coupled=coupled))
    if not is_rendered(results, name, coupled=coupled):
        return "cannot be rendered"
    return FEELINGS[verdict.outcome] if verdict else ""


def like_limits(boundaries: Sequence[Boundary], kind: str, families: Sequence[str]) -> list[Limits]:
    """Return the boundaries of both methods in one family and one shape, the Bayesian first."""
    shapes = list(_SHAPES)
    if any(boundary.device_share is not None for boundary in boundaries):
        # An envelope leaves out what is not known of the device.
        shapes.reverse()
    for shape in shapes:
        candidates = matching(boundaries, kind=kind, shape=shape)
        limits: list[Limits] = []
        for method in reversed(METHODS):
            boundary = first(matching(candidates, method=method), family=families)
            if boundary is not None:
                limits.append(_limits(boundary))
        if limits:
            return limits
    return []


def _limits(boundary: Boundary) -> Limits:
    method = METHOD_NAMES[boundary.method]
    averaged = ", over devices" if boundary.device_share is not None else ""
    return Limits(
        label=f"{method}, {boundary.shape} ({boundary.family}){averaged}",
        method=boundary.method,
        omega=boundary.omega,
        lower=boundary.lower,
        upper=boundary.upper,
        reference=boundary.reference,
    )
