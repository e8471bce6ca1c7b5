"""Curves over the angular frequency on axes, as in Figs 4 and 7 of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator
from numpy.typing import ArrayLike, NDArray

from percept.report.figures.canvas import (
    COLOURS,
    REFERENCE_DASHES,
    brief,
    common_range,
    log_scale,
    mark,
)

__all__ = ["Limits", "draw_magnitude", "draw_ratio", "draw_stability", "ratio_range"]

FloatArray = NDArray[np.float64]

_COUPLED_DASHES = (0, (2.5, 1.5))
_COUPLED_LABEL = "reference through the coupling"
# Long and short dashes as in the paper's Fig. 4; more couplings go on with other patterns.
_COUPLING_COLOURS = ("classical", "bayesian", "coupled", "warn")
_COUPLING_DASHES = ((0, (9, 3)), (0, (3, 2)), (0, (6, 2, 1, 2)), (0, (1, 1.5)))
#: Above and below the curves of a ratio, a factor.
_RATIO_ROOM = 1.06
#: Ends of a ratio's axis over each other, from which a strip has room for powers of ten alone.
_LONG_SPAN = 30.0


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
    _draw(ax, omega, limits, reference, coupled)
    if log:
        log_scale(ax, "x", plain=True)
        log_scale(ax, "y")
    else:
        ax.locator_params(nbins=5)
    ax.set_ylabel("|Zₕ| (N·s/m)")


def draw_ratio(
    ax: Axes,
    omega: FloatArray,
    limits: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None,
    ends: tuple[float, float],
) -> None:
    """Draw boundaries over the reference's abs(Z_h); arrows mark what leaves the axis' `ends`."""
    ratios = [pair.over_reference for pair in limits]
    low, high = ends
    coupled_ratio = None if coupled is None else coupled / reference
    _draw(ax, omega, ratios, np.ones_like(omega), coupled_ratio)
    ax.set_yscale("log", nonpositive="clip")
    log_scale(ax, "x", plain=True)
    ax.minorticks_off()
    steps = (1, 2, 5) if high < _LONG_SPAN * low else (1,)
    ax.yaxis.set_major_locator(LogLocator(subs=steps))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_ylim(low / _RATIO_ROOM, high * _RATIO_ROOM)
    highest = max((float(np.max(pair.upper)) for pair in ratios), default=1.0)
    lowest = min((float(np.min(pair.lower)) for pair in ratios), default=1.0)
    if highest > high:
        _say_beyond(ax, 0.97, "top", f"▲ {brief(highest)}")
    if lowest < low:
        _say_beyond(ax, 0.03, "bottom", f"▼ {brief(lowest)}")


def _say_beyond(ax: Axes, y: float, side: str, text: str) -> None:
    """Write how far curves go beyond the axis, in its right corner."""
    ax.text(
        0.98, y, text, fontsize=6.5, color=COLOURS["ink"], transform=ax.transAxes, ha="right",
        va=side,
    )  # fmt: skip


def ratio_range(panels: Sequence[Sequence[Limits]]) -> tuple[float, float]:
    """Return the ends of the axis that panels of boundaries over their references share."""
    lows: list[float] = []
    highs: list[float] = []
    for panel in panels:
        ratios = [pair.over_reference for pair in panel]
        lows.append(min(float(np.min(pair.lower)) for pair in ratios))
        highs.append(max(float(np.max(pair.upper)) for pair in ratios))
    return common_range(lows, highs, log=True)


def _draw(
    ax: Axes,
    omega: FloatArray,
    limits: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None,
) -> None:
    """Draw pairs of curves, the reference and the coupled impedance."""
    for pair in limits:
        colour = COLOURS[pair.method]
        drawn: list[Artist] = []
        if pair.method == "classical":
            drawn += ax.plot(pair.omega, pair.lower, color=colour, label=pair.label)
            drawn += ax.plot(pair.omega, pair.upper, color=colour)
        else:
            # The corner curves cross; the band between them is what is meant.
            low = np.minimum(pair.lower, pair.upper)
            high = np.maximum(pair.lower, pair.upper)
            band = ax.fill_between(
                pair.omega, low, high, color=colour, alpha=0.25, linewidth=0, label=pair.label
            )
            drawn.append(band)
            drawn += ax.plot(pair.omega, low, color=colour, linewidth=0.6)
            drawn += ax.plot(pair.omega, high, color=colour, linewidth=0.6)
        mark(ax, drawn, pair.method)
    ink = COLOURS["ink"]
    ax.plot(omega, reference, color=ink, linestyle=REFERENCE_DASHES, label="reference, |Zₕ|")
    if coupled is not None:
        green = COLOURS["coupled"]
        ax.plot(omega, coupled, color=green, linestyle=_COUPLED_DASHES, label=_COUPLED_LABEL)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")


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
            ax.plot([binding], [reached], "o", markersize=6, color=colour, gid=f"binding:{label}")
            ax.axvline(binding, color=colour, linewidth=0.7, linestyle=":")
            # In the legend, because the marks of like couplings lie on top of each other.
            line.set_label(f"{label}: {reached / needed:.3g} × bound at {binding:.4g} rad/s")
    log_scale(ax)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("admittance, real part (m/(N·s))")
    ax.margins(y=0.12)
    ax.legend(frameon=False, loc="upper left")


def _positive(values: ArrayLike) -> FloatArray:
    """Return a curve with gaps where it is zero or infinite: these have no logarithm."""
    curve = np.asarray(values, dtype=float)
    return np.where((curve > 0) & np.isfinite(curve), curve, np.nan)


def _at(frequency: float, omega: FloatArray, values: FloatArray) -> float:
    """Return a curve's value between its points, straight on the log-log axes."""
    known = np.isfinite(values)
    logs = np.interp(np.log(frequency), np.log(omega[known]), np.log(values[known]))
    return float(np.exp(logs))
