"""Curves of abs(Z_h): the boundary as in Fig. 7, and limits against the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.canvas import COLOURS, Axes

FloatArray = NDArray[np.float64]
#: Ratios to the reference that an axis shows at most: few subjects let limits run away.
SHOWN_RATIOS = (1e-4, 1e4)
#: A larger ratio than this asks for a logarithmic axis.
_LINEAR = 8.0
_REFERENCE = (0, (7, 3))
_COUPLED = (0, (2.5, 1.5))


@dataclass(frozen=True, eq=False)
class Limits:
    """A pair of curves to draw."""

    label: str  # For the legend
    method: str  # Decides colour and form: classical limits are lines, Bayesian ones a filled band
    omega: FloatArray  # (n,) rad/s
    lower: FloatArray  # (n,) N·s/m
    upper: FloatArray  # (n,) N·s/m
    reference: FloatArray  # (n,) abs(Z_h) of the reference at the same ω, N·s/m


def draw_magnitude(
    ax: Axes,
    omega: FloatArray,
    limits: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None = None,
    *,
    log: bool = True,
) -> None:
    """Draw boundaries, the reference and the coupled impedance, in the manner of Fig. 7."""
    _draw_limits(ax, limits)
    ax.plot(omega, reference, color=COLOURS["ink"], linestyle=_REFERENCE, label="reference, |Zₕ|")
    if coupled is not None:
        label = "reference through the coupling"
        ax.plot(omega, coupled, color=COLOURS["coupled"], linestyle=_COUPLED, label=label)
    if log:
        _log_axis(ax)
        ax.set_yscale("log")
        ax.yaxis.minorticks_off()
    else:
        ax.locator_params(nbins=5)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("angular frequency ω (rad/s)")
    ax.set_ylabel("|Zₕ| (N·s/m)")


def draw_ratio(
    ax: Axes,
    omega: FloatArray,
    limits: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None = None,
) -> None:
    """Draw boundaries divided by the reference's abs(Z_h), over the whole range."""
    ratios = _ratios(limits)
    _draw_limits(ax, ratios)
    ax.axhline(1.0, color=COLOURS["ink"], linestyle=_REFERENCE, label="reference, |Zₕ|")
    if coupled is not None:
        label = "reference through the coupling"
        ax.plot(omega, coupled / reference, color=COLOURS["coupled"], linestyle=_COUPLED, label=label)
    _log_axis(ax)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")
    seen = _positive(ratios)
    if seen.max(initial=0.0) > _LINEAR:
        # A boundary may reach zero, which has no place on a log axis.
        ax.set_yscale("log", nonpositive="clip")
        least, most = SHOWN_RATIOS
        ax.set_ylim(max(min(seen.min(), 1.0), least) / 1.3, min(max(seen.max(), 1.0), most) * 1.3)
        ax.yaxis.minorticks_off()
    else:
        ax.locator_params(axis="y", nbins=6)


def beyond_axis(limits: Sequence[Limits]) -> bool:
    """Say whether `draw_ratio` cuts some of the curves off."""
    seen = _positive(_ratios(limits))
    least, most = SHOWN_RATIOS
    return bool(seen.max(initial=0.0) > _LINEAR and (seen.min() < least or seen.max() > most))


def _ratios(limits: Sequence[Limits]) -> list[Limits]:
    return [replace(one, lower=one.lower / one.reference, upper=one.upper / one.reference) for one in limits]


def _positive(limits: Sequence[Limits]) -> FloatArray:
    curves = [curve for one in limits for curve in (one.lower, one.upper)]
    values = np.concatenate(curves) if curves else np.empty(0)
    return values[np.isfinite(values) & (values > 0)]


def _draw_limits(ax: Axes, limits: Sequence[Limits]) -> None:
    for one in limits:
        omega, colour = one.omega, COLOURS[one.method]
        if one.method == "classical":
            ax.plot(omega, one.lower, color=colour, label=one.label)
            ax.plot(omega, one.upper, color=colour)
        else:
            # The corner curves cross; the band between them is what is meant.
            low, high = np.minimum(one.lower, one.upper), np.maximum(one.lower, one.upper)
            ax.fill_between(omega, low, high, color=colour, alpha=0.25, linewidth=0, label=one.label)
            ax.plot(omega, low, color=colour, linewidth=0.6)
            ax.plot(omega, high, color=colour, linewidth=0.6)


def _log_axis(ax: Axes) -> None:
    ax.set_xscale("log")
    ax.xaxis.minorticks_off()
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
