"""Arrays to axes: intervals against their references, bands against impedance, couplings that qualify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from percept.report.figures.canvas import (
    COLOURS,
    brief,
    common_range,
    log_scale,
    mark,
    row_labels,
)
from percept.report.select import KINDS, METHOD_NAMES, METHODS

FloatArray = NDArray[np.float64]
_Style = dict[str, Any]
#: Keeps names and values readable over lines.
_GROUND = {"facecolor": COLOURS["paper"], "edgecolor": "none", "pad": 0.4}
_MARKERS = {"classical": "o", "bayesian": "D"}


@dataclass(frozen=True, eq=False)
class Bar:
    """An interval to draw, divided by its reference, or less its reference in the quantity's unit."""

    environment: str
    kind: str
    method: str
    lower: float
    upper: float
    estimate: float


_TICK = 0.11  # half the height of a subject's tick, in rows
_THICKNESS = {"mean": 3.2, "user": 1.6, "share": 0.7}


def draw_intervals(
    ax: Axes,
    environments: Sequence[str],
    bars: Sequence[Bar],
    values: Sequence[FloatArray],
    *,
    log: bool,
    labels: Sequence[str] | None = None,
    subject: str,
    names: Mapping[str, str],
    centre: float = 1.0,
) -> None:
    """Draw a group of bars per environment: kinds by thickness, methods by colour and mark.

    `names` are what kinds are called. The `centre` is where the references lie: 1 for bars divided by
    them, 0 for bars less them.
    """
    row = {environment: -index for index, environment in enumerate(environments)}
    present = [method for method in METHODS if any(bar.method == method for bar in bars)]
    kinds = [kind for kind in KINDS if any(bar.kind == kind for bar in bars)]
    log = log and any(bar.upper > 0 for bar in bars)
    left, right = _ends(bars, log=log, centre=centre)
    # Marks of no length stand for methods and kinds in the legend.
    for method in present:
        ax.plot([], [], color=COLOURS[method], linewidth=3, label=METHOD_NAMES[method])
    for kind in kinds:
        ax.plot([], [], color=COLOURS["quiet"], linewidth=_THICKNESS[kind], label=names[kind])
    for bar in bars:
        y = row[bar.environment] + _offset(kinds.index(bar.kind), bar.method, len(kinds), present)
        ends, colour = [max(bar.lower, left), min(bar.upper, right)], COLOURS[bar.method]
        drawn: list[Artist] = [*ax.plot(ends, [y, y], color=colour, linewidth=_THICKNESS[bar.kind])]
        for value, edge, side in ((bar.lower, left, "left"), (bar.upper, right, "right")):
            if value != min(max(value, left), right):
                drawn += _point_beyond(ax, edge, y, value, side, colour)
        if bar.kind == "mean" and left <= bar.estimate <= right:
            form: _Style = {
                "markersize": 3.4,
                "markerfacecolor": COLOURS["paper"],
                "markeredgecolor": colour,
            }
            drawn += ax.plot([bar.estimate], [y], _MARKERS[bar.method], **form)
        mark(ax, drawn, bar.method, bar.kind)
    for environment, subjects in zip(environments, values, strict=False):
        label = f"one {subject}" if len(subjects) else None
        # One path: a mark for each of hundreds of subjects makes a page of megabytes.
        tick = row[environment] - 0.42 + _TICK * np.array([-1.0, 1.0, np.nan])
        ax.plot(
            np.repeat(subjects, len(tick)),
            np.tile(tick, len(subjects)),
            linewidth=1.0,
            color=COLOURS["quiet"],
            label=label,
        )
    ax.axvline(centre, color=COLOURS["ink"], linestyle=(0, (7, 3)), linewidth=0.8)
    if log:
        log_scale(ax, "x", plain=True)
        # As many labels as fit: over three decades those between the powers of ten would touch.
        span = right / left
        subs = (1, 1.2, 1.5, 2, 3, 5, 7) if span < 5 else (1, 2, 5) if span < 1e3 else (1,)
        ax.xaxis.set_major_locator(LogLocator(subs=subs))
        ax.set_xlim(left / 1.03, right * 1.03)
    else:
        ax.set_xlim(left - 0.02 * (right - left), right + 0.02 * (right - left))
    ax.set_yticks(list(row.values()), environments if labels is None else labels)
    ax.set_ylim(-len(environments) + 0.4, 0.6)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)


def _ends(bars: Sequence[Bar], *, log: bool, centre: float) -> tuple[float, float]:
    """Return the ends of the axis: one environment far out does not flatten the rest."""
    groups = [
        [bar for bar in bars if bar.environment == name]
        for name in dict.fromkeys(bar.environment for bar in bars)
    ]
    sides = np.array(
        [(min(b.lower for b in group), max(b.upper for b in group)) for group in groups]
    )
    low, high = common_range(*sides.T, log=log, centre=centre)
    margin = 0.0 if log else 0.02 * (high - low)
    return low - margin, high + margin


def beyond_range(bars: Sequence[Bar], *, log: bool = True, centre: float = 1.0) -> bool:
    """Say whether some bar leaves the axis."""
    left, right = _ends(bars, log=log and any(bar.upper > 0 for bar in bars), centre=centre)
    return any(bar.lower < left or bar.upper > right for bar in bars)


def _point_beyond(
    ax: Axes, edge: float, y: float, value: float, side: str, colour: str
) -> list[Artist]:
    """Mark a bar that goes on beyond the axis, with the value it ends at."""
    arrow = {"left": "<", "right": ">"}[side]
    over = {"left": 3, "right": -3}[side]
    text = ax.annotate(
        brief(value), (edge, y), xytext=(over, 0), textcoords="offset points", ha=side, va="center",
        fontsize=5.2, bbox=_GROUND,
    )  # fmt: skip
    return [*ax.plot([edge], [y], marker=arrow, markersize=3, color=colour, clip_on=False), text]


def _offset(rank: int, method: str, kinds: int, present: Sequence[str]) -> float:
    """Return where in its row a bar stands: kinds from top to bottom, methods within a kind."""
    step = 0.72 / (kinds * len(present))
    return 0.38 - step * (rank * len(present) + present.index(method))


@dataclass(frozen=True, eq=False)
class Widths:
    """Bands of one method and kind."""

    label: str  # For the legend
    method: str
    environments: tuple[str, ...]
    size: FloatArray  # (n,) Impedance, or reference of a quantity
    band: FloatArray  # (n,) In the same unit
    laws: Mapping[str, FloatArray]  # (m,) Fitted band by the law's name, at the sizes drawn


_LAW_DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.5)))
_NAME_WIDTH = 26.0  # mm


def draw_band(
    ax: Axes, size: FloatArray, series: Sequence[Widths], *, axis: str, unit: str
) -> None:
    """Draw band against size on logarithmic axes, with the fitted laws."""
    for widths in series:
        colour, method = COLOURS[widths.method], METHOD_NAMES[widths.method]
        form: _Style = {"markersize": 4, "color": colour, "label": widths.label}
        ax.plot(widths.size, widths.band, _MARKERS[widths.method], **form)
        for (name, curve), dashes in zip(widths.laws.items(), _LAW_DASHES, strict=False):
            label = f"{method}: {name}"
            ax.plot(size, curve, color=colour, linewidth=0.9, linestyle=dashes, label=label)
    log_scale(ax)
    first = series[0]
    names = row_labels(first.environments, most=_NAME_WIDTH)
    middle = float(np.sqrt(size[0] * size[-1]))
    for name, x, y in zip(names, first.size, first.band, strict=True):
        # Bands grow with the size: what lies below a point on the left, and above it on the right,
        # is free.
        over, up, side = (4, -8, "left") if x < middle else (-4, 4, "right")
        ax.annotate(
            name,
            (x, y),
            xytext=(over, up),
            textcoords="offset points",
            ha=side,
            fontsize=6.5,
            bbox=_GROUND,
        )
    of = f" ({unit})" if unit else ""
    ax.set_xlabel(f"{axis}{of}")
    ax.set_ylabel(f"band{of}")


#: The axes of a map show at most this many times what qualifies.
_BEYOND = 4.0

Segments = Sequence[FloatArray]  # Per line of coupling damping: (n, 2) intervals of stiffness, N/m


def draw_design(
    ax: Axes,
    damping: FloatArray,
    intervals: Segments,
    *,
    stable: tuple[FloatArray, FloatArray] | None = None,
    coupling: tuple[float, float] | None = None,
    ends: tuple[float, float] | None = None,
) -> None:
    """Draw the couplings that are stable and stay inside a boundary, by stiffness and damping."""
    if stable is not None:
        stiffness, edge_damping = (np.append(side, side[0]) for side in stable)
        label = "edge of the stable region"
        ax.plot(stiffness / 1e3, edge_damping, color=COLOURS["quiet"], linewidth=0.8, label=label)
    boxes = _boxes(damping, intervals)
    if len(boxes):
        corners = boxes[:, [[0, 2], [1, 2], [1, 3], [0, 3], [0, 2]]]
        shade = PathPatch(
            Path.make_compound_path_from_polys(corners),
            color=COLOURS["coupled"],
            alpha=0.35,
            linewidth=0,
            antialiased=False,  # smoothed edges would leave a light line where boxes touch
            label="stable and inside the boundary",
        )
        # add_patch would look for the extent segment by segment; the ends are known.
        ax.add_artist(shade)
    else:
        ax.text(
            0.5, 0.5, "none qualifies", ha="center", color=COLOURS["quiet"], transform=ax.transAxes
        )
    right, top = ends or design_ends(damping, [intervals], stable=stable, coupling=coupling)
    if coupling is not None:
        x, y = coupling[0] / 1e3, coupling[1]
        at = (min(x, right), min(y, top))
        form: _Style = {"color": COLOURS["warn"], "label": "coupling in use", "clip_on": False}
        ax.plot([at[0]], [at[1]], "X", markersize=5, **form)
        if at != (x, y):
            place: _Style = {
                "textcoords": "offset points",
                "ha": "right",
                "va": "top",
                "fontsize": 6,
            }
            ax.annotate(f"at {x:.4g} kN/m,\n{y:.4g} N·s/m", at, xytext=(-6, -4), **place)
    ax.set_xlim(0, right)
    ax.set_ylim(0, top)
    ax.set_xlabel("coupling stiffness (kN/m)")


def design_ends(
    damping: FloatArray,
    maps: Sequence[Segments],
    *,
    stable: tuple[FloatArray, FloatArray] | None,
    coupling: tuple[float, float] | None,
) -> tuple[float, float]:
    """Return where the axes of maps end: behind what qualifies, and behind what is marked if it is near."""
    boxes = np.concatenate([np.zeros((1, 4)), *(_boxes(damping, intervals) for intervals in maps)])
    most = boxes[:, [1, 3]].max(axis=0)
    marks = [(coupling[0] / 1e3, coupling[1])] if coupling is not None else []
    if stable is not None:
        marks.append((float(stable[0].max()) / 1e3, float(stable[1].max())))
    marked = np.array([*marks, (0.0, 0.0)]).max(axis=0)
    if most.all():
        marked = np.minimum(marked, _BEYOND * most)
    right, top = 1.05 * np.maximum(most, marked)
    return float(right or 1.0), float(top or 1.0)


def _boxes(damping: FloatArray, intervals: Segments) -> FloatArray:
    """Return a box per line of b_c, up to half way to its neighbours; boxes may split and join."""
    edges = np.concatenate([damping[:1], (damping[1:] + damping[:-1]) / 2, damping[-1:]])
    boxes = [
        (low / 1e3, high / 1e3, edges[line], edges[line + 1])
        for line, segments in enumerate(intervals)
        for low, high in segments
    ]
    return np.array(boxes, dtype=float).reshape(-1, 4)
