"""Width of the band against the impedance of the environment, with the fitted laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS, MM, Axes, row_labels

FloatArray = NDArray[np.float64]
Box = tuple[float, float, float, float]
_NAME_WIDTH = 26.0  # mm
# Names on the figure, points: size, height, distance from the point, and heights they may stand at.
_SIZE, _TALL, _BESIDE = 6.5, 7.0, 4.0
_HEIGHTS = (-8.0, 3.0, -16.0, 11.0, -24.0, 19.0)
_MARK = {"classical": "o", "bayesian": "D"}
_DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.5)))


@dataclass(frozen=True, eq=False)
class Widths:
    """Bands of one method and kind."""

    label: str  # For the legend
    method: str
    environments: tuple[str, ...]
    impedance: FloatArray  # (n,) N·s/m
    band: FloatArray  # (n,) N·s/m
    laws: Mapping[str, FloatArray]  # (m,) Fitted band, N·s/m, by the law's name, at the impedances drawn


def draw_band(ax: Axes, impedance: FloatArray, series: Sequence[Widths]) -> None:
    """Draw band against impedance on logarithmic axes."""
    for one in series:
        colour = COLOURS[one.method]
        ax.plot(
            one.impedance,
            one.band,
            marker=_MARK[one.method],
            markersize=4,
            linestyle="none",
            color=colour,
            label=one.label,
        )
        for (name, curve), dashes in zip(one.laws.items(), _DASHES, strict=False):
            label = f"{one.label}: {name}"
            ax.plot(impedance, curve, color=colour, linewidth=0.9, linestyle=dashes, label=label)
    ax.set_xscale("log")
    ax.set_yscale("log")
    _name(ax, series)
    ax.minorticks_off()
    ax.set_xlabel("environment impedance |Zₑ| (N·s/m)")
    ax.set_ylabel("band (N·s/m)")


def _name(ax: Axes, series: Sequence[Widths]) -> None:
    """Name the first method's points where there is room: beside them, clear of points and other names."""
    first = series[0]
    names, _ = row_labels(first.environments, most=_NAME_WIDTH)
    # Limits are settled when they are asked for, and places follow from them.
    ax.get_xlim(), ax.get_ylim()
    points = 72.0 / ax.figure.dpi
    left, right = ax.bbox.x0 * points, ax.bbox.x1 * points

    def placed(one: Widths) -> FloatArray:
        return np.asarray(ax.transData.transform(np.column_stack([one.impedance, one.band]))) * points

    taken: list[Box] = [(x - 3, y - 3, x + 3, y + 3) for one in series for x, y in placed(one).tolist()]
    for name, at, (x, y) in zip(
        names, list(zip(first.impedance, first.band, strict=True)), placed(first).tolist(), strict=True
    ):
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


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
