"""Arrays to axes: intervals against their references, bands against impedance, couplings that qualify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS, MM, common_range, log_scale, mark, row_labels, shade_boxes
from percept.report.select import KIND_NAMES, KINDS, METHOD_NAMES, METHODS

FloatArray = NDArray[np.float64]
Box = tuple[float, float, float, float]
_MARKERS = {"classical": "o", "bayesian": "D"}


@dataclass(frozen=True, eq=False)
class Bar:
    """An interval to draw, relative to its reference."""

    environment: str
    kind: str
    method: str
    lower: float  # Divided by the reference
    upper: float  # Divided by the reference
    estimate: float  # Divided by the reference


_THICKNESS = {"mean": 3.2, "user": 1.6, "share": 0.7}


def draw_intervals(
    ax: Axes,
    environments: Sequence[str],
    bars: Sequence[Bar],
    values: Sequence[FloatArray],
    *,
    log: bool,
    labels: Sequence[str] | None = None,
    subject: str = "subject",
) -> None:
    """Draw a group of bars per environment: kinds by thickness, methods by colour and mark."""
    row = {environment: -index for index, environment in enumerate(environments)}
    present = [method for method in METHODS if any(bar.method == method for bar in bars)]
    kinds = [kind for kind in KINDS if any(bar.kind == kind for bar in bars)]
    log = log and any(bar.upper > 0 for bar in bars)
    left, right = _ends(bars, log=log)
    for bar in bars:
        y = row[bar.environment] + _offset(kinds.index(bar.kind), bar.method, len(kinds), present)
        drawn: list[Artist] = []
        drawn += ax.plot(
            [max(bar.lower, left), min(bar.upper, right)],
            [y, y],
            color=COLOURS[bar.method],
            linewidth=_THICKNESS[bar.kind],
            label=f"{KIND_NAMES[bar.kind]}, {METHOD_NAMES[bar.method]}",
        )
        for value, edge, side in ((bar.lower, left, "left"), (bar.upper, right, "right")):
            if value != min(max(value, left), right):
                drawn += _point_beyond(ax, edge, y, value, side, COLOURS[bar.method])
        if bar.kind == "mean" and left <= bar.estimate <= right:
            drawn += ax.plot(
                [bar.estimate],
                [y],
                marker=_MARKERS[bar.method],
                markersize=3.4,
                markerfacecolor=COLOURS["paper"],
                markeredgecolor=COLOURS[bar.method],
                linestyle="none",
            )
        mark(ax, drawn, bar.method, bar.kind)
    for environment, subjects in zip(environments, values, strict=False):
        ax.plot(
            subjects,
            np.full(len(subjects), row[environment] - 0.42),
            marker="|",
            markersize=5,
            color=COLOURS["quiet"],
            linestyle="none",
            label=f"one {subject}" if len(subjects) else None,
        )
    ax.axvline(1.0, color=COLOURS["ink"], linestyle=(0, (7, 3)), linewidth=0.8)
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


def _ends(bars: Sequence[Bar], *, log: bool) -> tuple[float, float]:
    """Return the ends of the axis: one environment far out does not flatten the rest."""
    sides = np.array(
        [
            (
                min(bar.lower for bar in bars if bar.environment == name),
                max(bar.upper for bar in bars if bar.environment == name),
            )
            for name in dict.fromkeys(bar.environment for bar in bars)
        ]
    )
    if not log:
        low, high = common_range(sides[:, 0], sides[:, 1], about=1.0)
        return low - 0.02 * (high - low), high + 0.02 * (high - low)
    with np.errstate(divide="ignore"):
        low, high = common_range(*np.log(np.maximum(sides, 0.0)).T, about=0.0)
    return float(np.exp(low)), float(np.exp(high))


def beyond_range(bars: Sequence[Bar], *, log: bool = True) -> bool:
    """Say whether some bar leaves the axis."""
    left, right = _ends(bars, log=log and any(bar.upper > 0 for bar in bars))
    return any(bar.lower < left or bar.upper > right for bar in bars)


def _point_beyond(ax: Axes, edge: float, y: float, value: float, side: str, colour: str) -> list[Artist]:
    """Mark a bar that goes on beyond the axis, with the value it ends at."""
    said = "∞" if not np.isfinite(value) else f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"
    arrow = {"left": "<", "right": ">"}[side]
    over = {"left": 3, "right": -3}[side]
    text = ax.annotate(
        said, (edge, y), xytext=(over, 0), textcoords="offset points", ha=side, va="center", fontsize=5.4,
        bbox={"facecolor": COLOURS["paper"], "edgecolor": "none", "pad": 0.4},
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
# Names on the figure, points: size, height, distance from the point, and heights they may stand at.
_SIZE, _TALL, _BESIDE = 6.5, 7.0, 4.0
_HEIGHTS = (-8.0, 3.0, -16.0, 11.0, -24.0, 19.0)


def draw_band(ax: Axes, size: FloatArray, series: Sequence[Widths], *, axis: str, unit: str) -> None:
    """Draw band against size on logarithmic axes, with the fitted laws."""
    for widths in series:
        colour = COLOURS[widths.method]
        ax.plot(
            widths.size,
            widths.band,
            marker=_MARKERS[widths.method],
            markersize=4,
            linestyle="none",
            color=colour,
            label=widths.label,
        )
        for (name, curve), dashes in zip(widths.laws.items(), _LAW_DASHES, strict=False):
            label = f"{widths.label}: {name}"
            ax.plot(size, curve, color=colour, linewidth=0.9, linestyle=dashes, label=label)
    log_scale(ax)
    _name(ax, series)
    of = f" ({unit})" if unit else ""
    ax.set_xlabel(f"{axis}{of}")
    ax.set_ylabel(f"band{of}")


def _name(ax: Axes, series: Sequence[Widths]) -> None:
    """Name the first method's points where there is room: beside them, clear of points and other names."""
    first = series[0]
    names, _ = row_labels(first.environments, most=_NAME_WIDTH)
    # Limits are settled when they are asked for, and places follow from them.
    ax.get_xlim(), ax.get_ylim()
    points = 72.0 / ax.figure.dpi
    left, right = ax.bbox.x0 * points, ax.bbox.x1 * points

    def placed(widths: Widths) -> list[list[float]]:
        at = ax.transData.transform(np.column_stack([widths.size, widths.band]))
        return [[x * points, y * points] for x, y in np.asarray(at).tolist()]

    taken: list[Box] = [(x - 3, y - 3, x + 3, y + 3) for widths in series for x, y in placed(widths)]
    data = zip(first.size, first.band, strict=True)
    for name, at, (x, y) in zip(names, data, placed(first), strict=True):
        long = row_labels([name], most=_NAME_WIDTH)[1] * MM * 72.0
        beside = {"left": x + _BESIDE, "right": x - _BESIDE - long}
        boxes: dict[tuple[str, float], Box] = {
            (side, up): (start, y + up, start + long, y + up + _TALL)
            for up in _HEIGHTS
            for side, start in beside.items()
        }
        free = (
            place
            for place, box in boxes.items()
            if left <= box[0] and box[2] <= right and not any(_overlap(box, other) for other in taken)
        )
        side, up = next(free, ("left", _HEIGHTS[0]))
        taken.append(boxes[side, up])
        over = _BESIDE if side == "left" else -_BESIDE
        ax.annotate(name, at, xytext=(over, up), textcoords="offset points", ha=side, fontsize=_SIZE)


def _overlap(box: Box, other: Box) -> bool:
    return box[0] < other[2] and other[0] < box[2] and box[1] < other[3] and other[1] < box[3]


#: The axes of a map show at most this many times what qualifies.
_BEYOND = 4.0


def draw_design(
    ax: Axes,
    damping: FloatArray,
    intervals: Sequence[FloatArray],
    *,
    stable: tuple[FloatArray, FloatArray] | None = None,
    coupling: tuple[float, float] | None = None,
) -> None:
    """Draw the couplings that are stable and stay inside a boundary, by stiffness and damping."""
    if stable is not None:
        stiffness, edge_damping = (np.append(side, side[0]) for side in stable)
        ax.plot(
            stiffness / 1e3,
            edge_damping,
            color=COLOURS["quiet"],
            linewidth=0.8,
            label="edge of the stable region",
        )
    # One bar per line of b_c, up to half way to its neighbours; unlike a polygon, bars may split and join.
    edges = np.concatenate([damping[:1], (damping[1:] + damping[:-1]) / 2, damping[-1:]])
    bars = [
        (low / 1e3, high / 1e3, edges[line], edges[line + 1])
        for line, segments in enumerate(intervals)
        for low, high in segments
    ]
    if bars:
        label = "stable and inside the boundary"
        shade_boxes(ax, np.array(bars), color=COLOURS["coupled"], alpha=0.35, label=label)
    else:
        ax.text(0.5, 0.5, "none qualifies", ha="center", color=COLOURS["quiet"], transform=ax.transAxes)
    marks = [(coupling[0] / 1e3, coupling[1])] if coupling is not None else []
    edge = [(float(stable[0].max()) / 1e3, float(stable[1].max()))] if stable is not None else []
    right = _end([bar[1] for bar in bars], [mark[0] for mark in marks + edge])
    top = _end([bar[3] for bar in bars], [mark[1] for mark in marks + edge])
    for x, y in marks:
        at = (min(x, right), min(y, top))
        ax.plot(
            [at[0]],
            [at[1]],
            marker="X",
            markersize=5,
            linestyle="none",
            color=COLOURS["warn"],
            clip_on=False,
            label="coupling in use",
        )
        if at != (x, y):
            said = f"at {x:.4g} kN/m,\n{y:.4g} N·s/m"
            ax.annotate(
                said, at, xytext=(-6, -4), textcoords="offset points", ha="right", va="top", fontsize=6
            )
    ax.set_xlim(0, right)
    ax.set_ylim(0, top)
    ax.set_xlabel("coupling stiffness (kN/m)")


def _end(qualifying: Sequence[float], marked: Sequence[float]) -> float:
    """Where an axis ends: behind what qualifies, and behind what is marked unless that is far out."""
    most = max(qualifying, default=0.0)
    shown = [min(value, _BEYOND * most) for value in marked] if most else marked
    return 1.05 * max([most, *shown], default=1.0) or 1.0
