"""Device damping that a virtual coupling needs, and how much of it there is (Eqs 9 and 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics._arrays import FloatArray, Scalars, one_of, ratio, stored, times
from percept.haptics._warp import HOLDS, Warp, checked_period, warp
from percept.haptics.impedance import device_parts, tustin_damping
from percept.haptics.parameters import AnyDevice, Coupling
from percept.notebook import NotebookRecord


@dataclass(frozen=True)
class RequiredDamping(NotebookRecord):
    """The damping a rigid device needs for a coupling.

    Attributes
    ----------
    damping : float or ndarray
        Smallest b_d with which Eq. 10 holds at every ω, N·s/m; inf where no damping suffices.
    omega : float or ndarray
        The ω that binds, rad/s.
    """

    damping: Scalars
    omega: Scalars


def required_damping_at(
    omega: ArrayLike,
    coupling: Coupling,
    period: float,
    *,
    discretization: str = "backward",
    hold: str = "average",
) -> FloatArray:
    """Return the Re Z_d(jω) that Eq. 10 asks for at each ω.

    g·[β(1 − y)/2 + K²y²/(8β(1 + y))] with y = cos(ωT/2), g the hold's gain (y for Eq. 8), K = k_c·T and β the
    coupling's damping in Tustin's form (b_c + K/2 for the backward difference).

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    coupling : Coupling
        Its parameters broadcast against ω.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    ndarray
        N·s/m; inf where no damping suffices, 0 without a coupling.

    Raises
    ------
    UsageError
        ω above Nyquist, T not positive, a value that is not finite, an unknown discretization or hold.
    """
    grid = warp(omega, period)
    viscous, elastic = demands(grid, hold)
    beta = tustin_damping(coupling, grid.period, discretization)
    stretch = np.multiply(coupling.stiffness, grid.period)
    # Only positive terms, and K²/β as K·(K/β): K² alone may leave the range of a double.
    load = stretch * ratio(stretch, beta, empty=0.0)
    needed = np.multiply(beta, viscous) + times(elastic, load)
    # A spring without a damper asks for infinitely much right up to Nyquist, so also there.
    return np.where(np.isinf(load), np.inf, needed)[()]


def demands(grid: Warp, hold: str) -> tuple[FloatArray, FloatArray]:
    """Return u and v of Eq. 10 as Re Z_d ≥ u·β + v·K²/β, β in Tustin's form and K = k_c·T."""
    gain = grid.held(hold).gain
    return gain * grid.one_minus_cos / 2, gain * grid.cos**2 / (8 * (1 + grid.cos))


def required_damping(
    coupling: Coupling, period: float, *, discretization: str = "backward", hold: str = "average"
) -> RequiredDamping:
    """Return the damping a rigid device needs for a coupling, in closed form (Eq. 10 over all ω).

    Parameters
    ----------
    coupling : Coupling
        Its parameters may be arrays.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    RequiredDamping
        Damping, N·s/m, and the ω where it binds, rad/s, of the coupling's shape.

    Raises
    ------
    UsageError
        T not positive, an unknown discretization or hold.

    Notes
    -----
    For Eq. 8 the maximum over y = cos(ωT/2) of βy(1 − y)/2 + K²y³/(8β(1 + y)) is stationary where
    2y³ + 3y² = 1/(1 − κ²), κ = K/2β. With C = cosh(⅔·atanh κ) that is y = C − ½ and the maximum
    β(2C − 1)/(4(C + 1)); from κ² = 0.8 on y stays at 1, that is ω = 0, with K²/16β. With the true hold the
    maximum is at one end: β/π at Nyquist, or K²/16β at DC.
    """
    period = checked_period(period)
    one_of(hold, "hold", HOLDS)
    beta = np.asarray(tustin_damping(coupling, period, discretization))
    stretch = np.multiply(coupling.stiffness, period)
    kappa = ratio(stretch, 2 * beta, empty=0.0)
    at_dc = np.where(kappa == 0, 0.0, stretch * (kappa / 8))
    if hold == "true":
        at_nyquist = beta / np.pi
        binds = np.where(at_dc > at_nyquist, 0.0, np.pi / period)
        return RequiredDamping(damping=stored(np.maximum(at_dc, at_nyquist)), omega=stored(binds))
    interior = kappa < _KAPPA_AT_DC
    inner = np.where(interior, kappa, 0.0)
    u = np.arctanh(inner) * (2 / 3)
    c = np.cosh(u)
    damping = np.where(interior, beta * ((2 * c - 1) / (4 * (c + 1))), at_dc)
    # 1 − y = cosh(u₁) − cosh(u) as a product, u₁ that of y = 1: next to DC the difference would be lost.
    short = np.arctanh((0.8 - inner**2) / ((_KAPPA_AT_DC + inner) * (1 - _KAPPA_AT_DC * inner))) * (2 / 3)
    one_minus_y = 2 * np.sinh(u + short / 2) * np.sinh(short / 2)
    omega = np.where(interior, (4 / period) * np.arcsin(np.sqrt(one_minus_y / 2)), 0.0)
    return RequiredDamping(damping=stored(damping), omega=stored(omega))


_KAPPA_AT_DC = float(np.sqrt(0.8))


def stability_margin(
    omega: ArrayLike,
    device: AnyDevice,
    coupling: Coupling,
    period: float,
    *,
    discretization: str = "backward",
    hold: str = "average",
) -> FloatArray:
    """Return Re Z_d(jω) over what Eq. 10 asks for at each ω: at least 1 everywhere means stable.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d.
    coupling : Coupling
        Its parameters broadcast against ω.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    ndarray
        Ratio, dimensionless; inf where nothing is asked for, 0 where the device gives nothing, negative where
        it is active.

    Raises
    ------
    UsageError
        ω above Nyquist or outside a device's table, T not positive, a value that is not finite, an unknown
        hold or discretization.
    """
    required = required_damping_at(omega, coupling, period, discretization=discretization, hold=hold)
    available, _ = device_parts(warp(omega, period), device)
    # Where both vanish together (at an end, without damping) the device fell short all the way there.
    joined = np.add(coupling.stiffness, coupling.damping) > 0
    return ratio(available, required, empty=np.where(joined, 0.0, np.inf))[()]


def coupling_bound(
    omega: ArrayLike, device: AnyDevice, period: float, *, hold: str = "average"
) -> FloatArray:
    """Return the right-hand side of Eq. 10, the lower bound of Re 1/Z_c that Fig. 4 draws.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    device : Device or TabulatedDevice
        The device, Z_d.
    period : float
        Sampling period T, s.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    ndarray
        m/(N·s); inf where the device dissipates nothing.

    Raises
    ------
    UsageError
        ω above Nyquist or outside a device's table, T not positive, a value that is not finite, an unknown
        hold.
    """
    grid = warp(omega, period)
    available, _ = device_parts(grid, device)
    viscous, _ = demands(grid, hold)
    return ratio(viscous, available, empty=np.inf)[()]
