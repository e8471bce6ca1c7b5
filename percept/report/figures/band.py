"""Width of the band against the impedance of the environment, with the fitted laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS, plain_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Widths", "draw_band"]

FloatArray = NDArray[np.float64]
_MARK = {"classical": "o", "bayesian": "D"}
_DASHES = ((None, None), (6, 2), (2, 1.5))


@dataclass(frozen=True, eq=False)
class Widths:
    """Bands of one method and kind.

    Attributes
    ----------
    method : {"classical", "bayesian"}
    environments : tuple of str
    impedance, band : ndarray, shape (n,)
        N·s/m.
    laws : mapping of str to ndarray, shape (m,)
        Fitted band, N·s/m, by the law's name, at the impedances drawn.
    """

    method: str
    environments: tuple[str, ...]
    impedance: FloatArray
    band: FloatArray
    laws: Mapping[str, FloatArray]


def draw_band(ax: Axes, impedance: FloatArray, series: Sequence[Widths]) -> None:
    """Draw band against impedance on logarithmic axes.

    Parameters
    ----------
    ax : matplotlib Axes
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
            label=one.method,
        )
        for (name, curve), dashes in zip(one.laws.items(), _DASHES, strict=False):
            drawn = ax.plot(impedance, curve, color=colour, linewidth=0.9, label=f"{one.method}: {name}")
            if dashes[0] is not None:
                drawn[0].set_dashes(dashes)
    first = series[0]
    for name, x, y in zip(first.environments, first.impedance, first.band, strict=True):
        ax.annotate(plain_text(name), (x, y), xytext=(4, -8), textcoords="offset points", fontsize=6.5)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("environment impedance |Z$_e$| (N·s/m)")
    ax.set_ylabel("band (N·s/m)")
