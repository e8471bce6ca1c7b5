"""The paper's criterion for a virtual coupling (Eq. 10): what it asks for, how much there is.

By Eqs 1 to 4, 9 and 10 a device and its coupling are absolutely stable, as two ports joined by
velocities, where Re Z_d is at least what Eq. 10 asks for at every ω. A loop that samples positions
aliases its forces, which this model leaves out: it may diverge where Eq. 10 is met. What such a
loop renders is in `percept.haptics.rendering`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import (
    LARGEST,
    FloatArray,
    IntArray,
    nonnegative_array,
    one_of,
    ratio,
    stored,
    times,
)
from percept.haptics.impedance import (
    DISCRETIZATIONS,
    coupling_element,
    device_parts,
    spring_damping,
)
from percept.haptics.loop import Loop, Warp, covers_range, search_grid
from percept.haptics.records import (
    Coupling,
    Device,
    NeededDamping,
    TabulatedDevice,
    refuse_arrays,
)
from percept.html import NotebookRecord
from percept.searches import lowest, secant_root

# How near to 1 a margin counts as on the limit.
_ROUNDING = 1e-12
# κ = K/2β from which on the demand is largest at DC.
_KAPPA_AT_DC = float(np.sqrt(0.8))
_NO_DEVICE = Device(0.0, 0.0)


def required_damping_at(
    loop: Loop, omega: ArrayLike, coupling: Coupling, *, discretization: str = "backward"
) -> FloatArray:
    """Return the Re Z_d(jω) that Eq. 10 asks for at each ω.

    g·[β(1 − y)/2 + K²y²/(8β(1 + y))] with y = cos(ωT/2), g the hold's gain (y for Eq. 8), K = k_c·T
    and β the coupling's damping in Tustin's form (b_c + K/2 for the backward difference). With a
    delay of d samples it is g·[1 − cos((d + ½)ωT)]/2·[β + K²/(4β·tan²(ωT/2))]. A velocity filter F
    puts Re Z_c in place of β, and −Ω·T·Im Z_c in place of K.

    Parameters
    ----------
    loop : Loop
        Its device does not count.
    omega : array_like
        rad/s, up to π/T in magnitude.
    coupling : Coupling
        Its parameters broadcast against ω.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.

    Returns
    -------
    ndarray
        N·s/m; inf where no damping suffices, 0 without a coupling.

    Raises
    ------
    UsageError
        ω above Nyquist, a value that is not finite, an unknown discretization.
    """
    grid = loop.at(omega)
    viscous, elastic = demands(grid)
    element = coupling_element(grid, coupling, discretization)
    beta = element.damping
    stretch = np.multiply(element.stiffness, grid.period)
    # Only positive terms, and K²/β as K·(K/β): K² alone may leave the range of a double.
    k2_over_beta = stretch * ratio(stretch, beta, empty=0.0)
    if loop.velocity_filter is not None:
        # A filter may make the coupling active: no device then suffices.
        k2_over_beta = np.where(np.less(beta, 0), np.inf, k2_over_beta)
    needed = np.multiply(beta, viscous) + times(elastic, k2_over_beta)
    # A spring without a damper asks for infinitely much right up to Nyquist, so also there.
    return np.where(np.isinf(k2_over_beta), np.inf, needed)[()]


class Demands(NamedTuple):
    """Eq. 10 as Re Z_d ≥ viscous·β + elastic·K²/β, with β in Tustin's form and K = k_c·T."""

    viscous: FloatArray
    elastic: FloatArray


def demands(grid: Warp) -> Demands:
    """Return what Eq. 10 asks for at each ω, of ω's shape."""
    gain = grid.held().gain
    delay = grid.loop.delay
    # 1 − cos((1 + 2d)h) is 2 sin²((½ + d)h); its ratio to sin² h is finite at DC.
    sine = np.sin((0.5 + delay) * grid.half)
    per_sine = ratio(sine, grid.sin, empty=0.5 + delay)
    return Demands(viscous=gain * sine**2, elastic=gain * (per_sine * grid.cos / 2) ** 2)


def required_damping(
    loop: Loop, coupling: Coupling, *, discretization: str = "backward"
) -> NeededDamping:
    """Return the damping a rigid device needs for a coupling (Eq. 10 over all ω).

    It is a closed form without delay and filter, and searched over ω with one. Parameters as in
    `required_damping_at`.

    Returns
    -------
    NeededDamping
        Damping, N·s/m, and the ω where it binds, rad/s, of the coupling's shape.

    Raises
    ------
    UsageError
        As `required_damping_at`.

    Notes
    -----
    For Eq. 8 the maximum over y = cos(ωT/2) of βy(1 − y)/2 + K²y³/(8β(1 + y)) is stationary where
    2y³ + 3y² = 1/(1 − κ²), κ = K/2β. With C = cosh(⅔·atanh κ) that is y = C − ½ and the maximum
    β(2C − 1)/(4(C + 1)); from κ² = 0.8 on y stays at 1, that is ω = 0, with K²/16β. With the true
    hold the maximum is at one end: β/π at Nyquist, or K²/16β at DC.
    """
    if loop.delay or loop.velocity_filter is not None:
        return _searched_damping(loop, coupling, discretization)
    period = loop.period
    beta = np.add(coupling.damping, spring_damping(coupling, period, discretization))
    stretch = np.multiply(coupling.stiffness, period)
    kappa = ratio(stretch, 2 * beta, empty=0.0)
    at_dc = np.where(kappa == 0, 0.0, stretch * (kappa / 8))
    if loop.hold == "true":
        at_nyquist = beta / np.pi
        damping = np.maximum(at_dc, at_nyquist)
        omega = np.where(at_dc > at_nyquist, 0.0, np.pi / period)
        return NeededDamping(stored(damping), stored(omega))
    interior = kappa < _KAPPA_AT_DC
    inner = np.where(interior, kappa, 0.0)
    u = np.arctanh(inner) * (2 / 3)
    c = np.cosh(u)
    at_stationary = beta * ((2 * c - 1) / (4 * (c + 1)))
    damping = np.where(interior, at_stationary, at_dc)
    # 1 − y = cosh(u₁) − cosh(u) as a product, u₁ that of y = 1: next to DC the difference would be
    # lost. u₁ − u is in closed form too.
    above = (_KAPPA_AT_DC + inner) * (1 - _KAPPA_AT_DC * inner)
    rise = np.arctanh((0.8 - inner**2) / above) * (2 / 3)
    one_minus_y = 2 * np.sinh(u + rise / 2) * np.sinh(rise / 2)
    quarter_angle = np.arcsin(np.sqrt(one_minus_y / 2))
    omega = np.where(interior, (4 / period) * quarter_angle, 0.0)
    return NeededDamping(stored(damping), stored(omega))


def _searched_damping(loop: Loop, coupling: Coupling, discretization: str) -> NeededDamping:
    """Return what `required_damping` does, by a search over ω."""
    k_c, b_c = np.broadcast_arrays(coupling.stiffness, coupling.damping)
    flat = Coupling(k_c.ravel(), b_c.ravel())

    def negative_demand(omega: FloatArray, which: IntArray) -> FloatArray:
        each = flat.select(which)
        needed = required_damping_at(loop, omega, each, discretization=discretization)
        # Differences of infinities would hide a dip from the search.
        return np.where(np.isinf(needed), -LARGEST, -needed)

    least = lowest(negative_demand, search_grid(replace(loop, device=_NO_DEVICE)), k_c.size)
    needed = np.where(least.value == -LARGEST, np.inf, -least.value)
    return NeededDamping(stored(needed.reshape(k_c.shape)), stored(least.x.reshape(k_c.shape)))


def stability_margin(
    loop: Loop, omega: ArrayLike, coupling: Coupling, *, discretization: str = "backward"
) -> FloatArray:
    """Return Re Z_d(jω) over what Eq. 10 asks for at each ω: at least 1 where it is met.

    Parameters as in `required_damping_at`; here the device, Z_d, counts.

    Returns
    -------
    ndarray
        Ratio, dimensionless; inf where nothing is asked for, 0 where the device gives nothing,
        negative where it is active.

    Raises
    ------
    UsageError
        As `required_damping_at`, and ω outside a device's table.
    """
    required = required_damping_at(loop, omega, coupling, discretization=discretization)
    available, _ = device_parts(loop.at(omega))
    # Where both vanish together (at an end, without damping) the device fell short all the way
    # there.
    joined = np.add(coupling.stiffness, coupling.damping) > 0
    return ratio(available, required, empty=np.where(joined, 0.0, np.inf))[()]


def coupling_bound(loop: Loop, omega: ArrayLike) -> FloatArray:
    """Return the lower bound of Re 1/Z_c in Eq. 10 and Fig. 4.

    Parameters as in `stability_margin`.

    Returns
    -------
    ndarray
        m/(N·s), of ω's shape; inf where the device dissipates nothing.

    Raises
    ------
    UsageError
        ω above Nyquist or outside a device's table.
    """
    grid = loop.at(omega)
    available, _ = device_parts(grid)
    return ratio(demands(grid).viscous, available, empty=np.inf)[()]


Verdict = Literal["met", "on its limit", "not met", "undecided"]


@dataclass(frozen=True)
class AbsoluteStability(NotebookRecord):
    """Whether Eq. 10 is met at every ω.

    On its limit means that the smallest margin is 1 to within rounding; undecided, that Eq. 10 is
    met as far as the device's table goes, which leaves out a part of the range.
    """

    verdict: Verdict
    reason: str  # The condition that decides, in one sentence
    smallest_margin: float
    binding_omega: float  # Where the margin is smallest, rad/s


def absolute_stability(
    loop: Loop, coupling: Coupling, *, discretization: str = "backward"
) -> AbsoluteStability:
    """Judge a device with a coupling at every ω from DC to Nyquist (Eqs 9, 10).

    A rigid device is judged in closed form, with a delay by a search. With modes the smallest
    margin is searched on a grid that resolves each mode, and refined; a table is searched over the
    range it covers, and cannot show that Eq. 10 is met where that is not all of it.

    Parameters as in `stability_margin`, for one device and one coupling.

    Returns
    -------
    AbsoluteStability
        `verdict`, its `reason`, `smallest_margin`, and `binding_omega` in rad/s.

    Raises
    ------
    UsageError
        Arrays as parameters, a table that begins above Nyquist, an unknown discretization.

    Notes
    -----
    Llewellyn's criterion also asks that no pole of Eq. 4's matrix lies outside the unit circle.
    None does: records refuse negative masses, stiffnesses and dampings, and Tustin's method keeps
    the left half plane inside the circle. The coupling's pole, (2β − K)/(2β + K) with K = k_c·T,
    lies inside it too. A delay multiplies the hold: whole samples add poles at zero.
    With a fraction of a sample the loop is no polynomial. The tests count its poles instead.
    """
    device = loop.device
    refuse_arrays(device, coupling)
    if loop.rigid is not None:
        need = required_damping(loop, coupling, discretization=discretization)
        smallest = float(ratio(loop.rigid.damping, need.damping, empty=np.inf))
        binding = float(need.omega)
    else:

        def margin(omega: FloatArray, _: IntArray) -> FloatArray:
            found = stability_margin(loop, omega, coupling, discretization=discretization)
            return np.asarray(found)

        least = lowest(margin, search_grid(loop), 1)
        smallest = float(least.value[0])
        binding = float(least.x[0])
    verdict: Verdict = "met" if smallest > 1 + _ROUNDING else "on its limit"
    reason = f"The smallest margin is {smallest:.6g}, at {binding:.6g} rad/s."
    if smallest < 1 - _ROUNDING:
        verdict = "not met"
        element = coupling_element(loop.at(binding), coupling, discretization)
        if np.less(element.damping, 0):
            reason = f"The velocity filter makes the coupling active at {binding:.6g} rad/s."
        elif smallest < 0:
            reason = f"A port is active: its real part is negative at {binding:.6g} rad/s."
    elif isinstance(device, TabulatedDevice) and not covers_range(loop):
        verdict = "undecided"
        reason = (
            f"From {device.omega[0]:.6g} to {device.omega[-1]:.6g} rad/s the smallest margin is"
            f" {smallest:.6g}; of the rest, up to {loop.nyquist:.6g} rad/s, the device's table"
            " says nothing."
        )
    return AbsoluteStability(verdict, reason, smallest, binding)


def max_coupling_stiffness(
    loop: Loop, coupling_damping: ArrayLike, *, discretization: str = "backward"
) -> FloatArray:
    """Return the largest k_c with which a rigid device meets Eq. 10.

    Parameters
    ----------
    loop : Loop
        Without a delay; of its device the damping alone counts, b, which may be an array.
    coupling_damping : array_like
        b_c, N·s/m, zero or more.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.

    Returns
    -------
    ndarray
        N/m, of the broadcast shape; 0 where no positive stiffness does.

    Raises
    ------
    UsageError
        A negative damping, a value that is not finite, an unknown discretization; a loop with a
        delay, a filter, modes or a table.
    """
    one_of(discretization, "discretization", DISCRETIZATIONS)
    device = loop.rigid
    if loop.delay or loop.velocity_filter or device is None:
        raise UsageError(
            "the largest stiffness is known for a rigid device without delay and filter.",
            hint="Compare the device with required_damping of several couplings.",
        )
    b_c = nonnegative_array(coupling_damping, "coupling damping", "N·s/m")
    b, b_c = np.broadcast_arrays(np.asarray(device.damping), b_c)
    shape = b.shape
    b = b.ravel()
    b_c = b_c.ravel()

    def missing(which: IntArray, stretch: FloatArray) -> FloatArray:
        coupling = Coupling(stretch / loop.period, b_c[which])
        need = required_damping(loop, coupling, discretization=discretization)
        return need.damping - b[which]

    # What holds at DC: K² = 16·b·β.
    root_b = np.sqrt(b)
    top = 4 * root_b * np.sqrt(b_c)
    if discretization == "backward":
        top = 4 * root_b * (root_b + np.sqrt(b + b_c))
    stretch = secant_root(missing, top / 2, 0 * top, top)
    every = np.arange(top.size)
    stretch = np.where(missing(every, top) <= 0, top, stretch)
    stretch = np.where(missing(every, 0 * top) >= 0, 0.0, stretch)
    return (stretch / loop.period).reshape(shape)[()]
