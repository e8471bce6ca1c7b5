"""The filter of a measured velocity: a Butterworth low pass, by Tustin's method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from percept.errors import UsageError
from percept.haptics.arrays import ComplexArray, FloatArray, complex_from, ratio, real_array
from percept.haptics.axis import Warp

__all__ = ["FilteredDamper", "VelocityFilter", "filter_response", "filtered_damper"]

# Sections of a higher order differ less from an ideal low pass than sensors do.
_HIGHEST_ORDER = 8


@dataclass(frozen=True)
class VelocityFilter:
    """A low pass that the velocity goes through before a damper acts on it.

    It is Butterworth's, discretized by Tustin's method so that the cutoff stays where it is.

    Parameters
    ----------
    cutoff : float
        rad/s, where the gain is √½; above zero, and below π/T of the loop it is used in.
    order : int, optional
        1 to 8.

    Raises
    ------
    UsageError
        A cutoff or an order out of these ranges.
    """

    cutoff: float
    order: int = 1

    def __post_init__(self) -> None:
        cutoff = real_array(self.cutoff, "cutoff of the velocity filter", "rad/s")
        if cutoff.ndim or not cutoff > 0:
            raise UsageError(
                "cutoff of the velocity filter must be one number above zero, in rad/s.",
                value=self.cutoff,
                hint="A cutoff in Hz is multiplied by 2π.",
            )
        if self.order not in range(1, _HIGHEST_ORDER + 1):
            raise UsageError(
                f"order of the velocity filter must be 1 to {_HIGHEST_ORDER}.", value=self.order
            )
        object.__setattr__(self, "cutoff", float(cutoff))


def filter_response(grid: Warp, velocity_filter: VelocityFilter) -> ComplexArray:
    """Return F(jω), exact from DC, 1, to Nyquist, 0.

    Parameters
    ----------
    grid : Warp
        Angles of ω.
    velocity_filter : VelocityFilter
        Its cutoff lies below Nyquist.

    Returns
    -------
    ndarray of complex
        Dimensionless, of ω's shape.

    Raises
    ------
    UsageError
        The cutoff does not lie below Nyquist.

    Notes
    -----
    With x = tan h/tan h_c, h_c half the cutoff times T, a pair of poles of damping ratio ζ gives
    1/(1 − x² + 2jζx), and the pole of an odd order 1/(1 + jx). Both are multiplied by powers of
    u = cos h·sin h_c, so that nothing is infinite, with v = sin h·cos h_c in place of x. Then
    u² − v² is sin(h_c − h)·sin(h_c + h).
    """
    half_cutoff = velocity_filter.cutoff * grid.period / 2
    if not half_cutoff < np.pi / 2:
        raise UsageError(
            "cutoff of the velocity filter does not lie below the Nyquist frequency,"
            f" {np.pi / grid.period:.6g} rad/s.",
            value=velocity_filter.cutoff,
            hint="Lower the cutoff (rad/s, not Hz), or shorten the period.",
        )
    u = grid.cos * np.sin(half_cutoff)
    v = grid.sin * np.cos(half_cutoff)
    difference = np.sin(half_cutoff - grid.half) * np.sin(half_cutoff + grid.half)
    order = velocity_filter.order
    response = np.ones(grid.omega.shape, dtype=np.complex128)
    if order % 2:
        response = u / complex_from(u, v)
    for pair in range(order // 2):
        damping_ratio = np.sin((2 * pair + 1) * np.pi / (2 * order))
        response = response * (u * u / complex_from(difference, 2 * damping_ratio * u * v))
    return np.asarray(response)


class FilteredDamper(NamedTuple):
    """What a filtered damper of 1 N·s/m shows at each ω."""

    damping: FloatArray  # Re F, N·s/m
    stiffness: FloatArray  # −Ω·Im F, N/m


def filtered_damper(grid: Warp, velocity_filter: VelocityFilter) -> FilteredDamper:
    """Return the damping and the stiffness that a filter leaves of a damper.

    Parameters
    ----------
    grid : Warp
        Angles of ω.
    velocity_filter : VelocityFilter
        Its cutoff lies below Nyquist.

    Returns
    -------
    FilteredDamper
        For each N·s/m of the damper. Both may be negative from the second order on.

    Raises
    ------
    UsageError
        As `filter_response`.
    """
    response = filter_response(grid, velocity_filter)
    # At Nyquist Ω·Im F is the warped cutoff for the first order, and vanishes for the others.
    end = 0.0
    if velocity_filter.order == 1:
        end = (2 / grid.period) * float(np.tan(velocity_filter.cutoff * grid.period / 2))
    stiffness = ratio(-response.imag * (2 / grid.period) * grid.sin, grid.cos, empty=end)
    at_nyquist = grid.cos == 0
    return FilteredDamper(response.real, np.where(at_nyquist, end, stiffness))
