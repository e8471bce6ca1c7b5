"""What axes can hold: lines, shaded bands, bars, rules across, and notes at points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Bars", "Line", "Note", "Rule", "Shade", "dashes_of"]

Array = NDArray[np.float64]
_NAMED: dict[str, tuple[float, ...]] = {"-": (), "solid": (), "none": (), ":": (1.0, 1.65), "--": (3.7, 1.6)}


def dashes_of(style: Any) -> tuple[float, ...]:
    """Return the lengths, in line widths, of a named style or of matplotlib's ``(offset, lengths)``."""
    return _NAMED[style] if isinstance(style, str) else tuple(style[1])


@dataclass
class Line:
    """A curve or a row of marks.

    Attributes
    ----------
    x, y : ndarray, shape (n,)
        In the axes' units; NaN leaves a gap.
    color : str
        ``#rrggbb``.
    label : str or None
        For the legend.
    linewidth : float
        pt; zero: marks only.
    dashes : tuple of float
        In line widths; empty: solid.
    marker : str
        One of ``o D X |``, or empty.
    markersize : float
        pt.
    face, edge : str
        Colours of the marks.
    """

    x: Array
    y: Array
    color: str
    label: str | None
    linewidth: float
    dashes: tuple[float, ...]
    marker: str
    markersize: float
    face: str
    edge: str
    gid: str | None = None

    def get_color(self) -> str:
        """Return the colour."""
        return self.color

    def set_label(self, label: str) -> None:
        """Change what the legend says."""
        self.label = label

    def set_gid(self, gid: str) -> None:
        """Name the line; the name is for those who look for it among the axes' lines."""
        self.gid = gid

    def get_gid(self) -> str | None:
        """Return the line's name."""
        return self.gid


@dataclass(frozen=True, eq=False)
class Shade:
    """The area between two curves over the same x."""

    x: Array
    low: Array
    high: Array
    color: str
    alpha: float
    label: str | None


@dataclass(frozen=True, eq=False)
class Bars:
    """Rectangles from `left` to `right` and `bottom` to `top`, each ndarray of shape (n,)."""

    left: Array
    right: Array
    bottom: Array
    top: Array
    color: str
    alpha: float
    label: str | None


@dataclass(frozen=True)
class Rule:
    """A line across the axes at one place, level or upright."""

    place: float
    level: bool
    color: str
    label: str | None
    linewidth: float
    dashes: tuple[float, ...]


@dataclass(frozen=True)
class Note:
    """Text beside a point, `offset` pt to the right and upward."""

    text: str
    point: tuple[float, float]
    offset: tuple[float, float]
    size: float


Mark = Line | Shade | Bars | Rule | Note


def values(given: ArrayLike) -> Array:
    """Return numbers as a flat float array."""
    return np.atleast_1d(np.asarray(given, dtype=float)).ravel()


def extent(marks: Sequence[Mark]) -> tuple[list[Array], list[Array]]:
    """Return what the marks ask to be seen along x and along y."""
    across, upward = [np.empty(0)], [np.empty(0)]
    for mark in marks:
        match mark:
            case Line():
                seen = np.isfinite(mark.x) & np.isfinite(mark.y)
                across.append(mark.x[seen])
                upward.append(mark.y[seen])
            case Shade():
                across.append(mark.x)
                upward += [mark.low, mark.high]
            case Bars():
                across += [mark.left, mark.right]
                upward += [mark.bottom, mark.top]
            case Rule():
                (upward if mark.level else across).append(np.array([mark.place]))
            case Note():
                pass
    return across, upward
