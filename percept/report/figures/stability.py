"""The stability criterion over ω: Re 1/Z_c of each coupling against its lower bound (Fig. 4)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError
from percept.report.figures.canvas import COLOURS, Axes

# Long and short dashes as in the paper's figure; more couplings go on with other patterns.
_COLOURS = ("classical", "bayesian", "coupled", "warn")
_DASHES = ((0, (9, 3)), (0, (3, 2)), (0, (6, 2, 1, 2)), (0, (1, 1.5)))


def draw_stability(
    ax: Axes,
    omega: ArrayLike,
    bound: ArrayLike,
    couplings: Mapping[str, ArrayLike],
    *,
    binding: Mapping[str, float] | None = None,
) -> None:
    """Draw the right-hand side of Eq. 10 and the couplings it has to stay below."""
    omega, bound = np.asarray(omega, dtype=float), np.asarray(bound, dtype=float)
    curves = {label: np.asarray(curve, dtype=float) for label, curve in couplings.items()}
    for label, curve in {"bound": bound, **curves}.items():
        if omega.ndim != 1 or curve.shape != omega.shape:
            raise UsageError(f"{label!r} and omega differ in length.", value=(curve.shape, omega.shape))
    if omega.size < 2 or omega[0] <= 0 or (np.diff(omega) <= 0).any():
        raise UsageError("omega must be positive and increasing to be drawn on a log axis.")

    unknown = set(binding or ()) - set(curves)
    if unknown:
        raise UsageError("binding names a coupling that is not drawn.", value=sorted(unknown))

    (line,) = ax.plot(
        omega, _drawable(bound), color=COLOURS["ink"], linewidth=1.4, label="lower bound (Eq. 10)"
    )
    line.set_gid("bound")
    styles = zip(cycle(_DASHES), cycle(_COLOURS), strict=False)
    for (label, curve), (dashes, colour) in zip(curves.items(), styles, strict=False):
        (line,) = ax.plot(
            omega, _drawable(curve), color=COLOURS[colour], linestyle=dashes, linewidth=1.4, label=label
        )
        line.set_gid(f"coupling:{label}")
        if binding and label in binding:
            times = _mark(ax, label, omega, curve, bound, float(binding[label]), COLOURS[colour])
            # In the legend, because the marks of like couplings lie on top of each other.
            line.set_label(f"{label}: {times:.3g} × bound at {binding[label]:.4g} rad/s")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.minorticks_off()
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("angular frequency ω (rad/s)")
    ax.set_ylabel("coupling admittance, real part (m/(N·s))")
    ax.margins(y=0.12)
    ax.legend(frameon=False, loc="upper left")


def _drawable(curve: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the curve with gaps where it is zero or infinite, which have no place on a log axis."""
    return np.where((curve > 0) & np.isfinite(curve), curve, np.nan)


def _mark(
    ax: Axes,
    label: str,
    omega: NDArray[np.float64],
    curve: NDArray[np.float64],
    bound: NDArray[np.float64],
    binding: float,
    colour: Any,
) -> float:
    """Mark where a coupling binds, and return how many times the bound it reaches there."""
    if not omega[0] <= binding <= omega[-1]:
        raise UsageError(
            "a binding frequency lies outside the range drawn.",
            value=binding,
            hint="Draw a wider range, or leave the mark out.",
        )
    reached, asked = (_at(binding, omega, _drawable(values)) for values in (curve, bound))
    (dot,) = ax.plot([binding], [reached], marker="o", markersize=6, color=colour, linestyle="none")
    dot.set_gid(f"binding:{label}")
    ax.axvline(binding, color=colour, linewidth=0.7, linestyle=":")
    return reached / asked


def _at(place: float, omega: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Return a curve's value between its points, straight on the log-log axes."""
    kept = np.isfinite(values)
    return float(np.exp(np.interp(np.log(place), np.log(omega[kept]), np.log(values[kept]))))
