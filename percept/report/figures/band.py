"""Width of the band against the impedance of the environment, with the fitted laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS, Axes, row_labels

__all__ = ["Widths", "draw_band"]

FloatArray = NDArray[np.float64]
_NAME_WIDTH = 26.0  # mm
_MARK = {"classical": "o", "bayesian": "D"}
_DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.5)))


@dataclass(frozen=True, eq=False)
class Widths:
    """Bands of one method and kind.

    Attributes
    ----------
    label : str
        For the legend.
    method : {"classical", "bayesian"}
    environments : tuple of str
    impedance, band : ndarray, shape (n,)
        N·s/m.
    laws : mapping of str to ndarray, shape (m,)
        Fitted band, N·s/m, by the law's name, at the impedances drawn.
    """

    label: str
    method: str
    environments: tuple[str, ...]
    impedance: FloatArray
    band: FloatArray
    laws: Mapping[str, FloatArray]


def draw_band(ax: Axes, impedance: FloatArray, series: Sequence[Widths]) -> None:
    """Draw band against impedance on logarithmic axes.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    impedance : ndarray, shape (m,)
        Where the laws are drawn, N·s/m.
    series : sequence of Widths
        One per method.
    """
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
    first = series[0]
    names, _ = row_labels(first.environments, most=_NAME_WIDTH)
    for name, x, y in zip(names, first.impedance, first.band, strict=True):
        ax.annotate(name, (x, y), xytext=(4, -8), textcoords="offset points", fontsize=6.5)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.minorticks_off()
    ax.set_xlabel("environment impedance |Zₑ| (N·s/m)")
    ax.set_ylabel("band (N·s/m)")
