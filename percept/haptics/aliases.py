"""What a device dissipates at all aliases of a frequency together.

A sampled loop sees a device at θ_k = ωT + 2πk at once, k being any whole number. With r(θ) for
Re Z_d in continuous time (no Tustin's method), and f for the part of a sample in the loop's delay,
two sums over all k count:

    plain = Σ 4/(θ_k²·r(θ_k))        late = Σ 4·e^{−jθ_k·f}/(θ_k²·r(θ_k))

Next to DC they grow without bound, as they do for a constant r. With h = ωT/2 these are known:

    Σ 4/θ_k² = 1/sin² h              Σ 4·e^{−jθ_k·f}/θ_k² = (1 − f + f·e^{−2jh})/sin² h

So a part of each sum is taken with a constant r, and the rest stays finite.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from percept.haptics.arrays import LARGEST, ComplexArray, FloatArray, Scalars
from percept.haptics.loop import Loop, Warp
from percept.haptics.records import Device, TabulatedDevice

# Damping at DC of a device that has none there, as a fraction of that of its modes: at zero the
# sums have a pole.
_LEAST_AT_DC = 1e-12
# Smallest h, rad, that a table is summed at. Of 1/sin² h − 1/h² nine digits are left here, fewer
# nearer to DC, where the sums hardly move.
_NEAR_DC = 1e-3
# Where a feature is looked at, in its widths to either side: each half as far again as the last.
_OFFSETS = np.geomspace(1e-2, 1e2, 25)


class Aliases(NamedTuple):
    """Both sums: plain = constant/sin² h + rest, late = constant·turn/sin² h + late_rest."""

    constant: Scalars  # 1/r that is taken as constant, m/(N·s)
    turn: ComplexArray  # 1 − f + f·e^{−2jh}
    rest: FloatArray  # m/(N·s); zero for a rigid device
    late_rest: ComplexArray


def aliases(grid: Warp) -> Aliases:
    """Return the sums over the aliases of each ω.

    Parameters
    ----------
    grid : Warp
        Angles of ω in a loop. Its device has single numbers; the damping of a rigid device may be
        an array. Above a table's end its floor holds, and without a floor those aliases count for
        nothing.

    Returns
    -------
    Aliases
    """
    device = grid.loop.device
    fraction, _ = math.modf(grid.loop.delay)
    if isinstance(device, TabulatedDevice):
        return _of_table(grid, device, fraction)
    rest = np.zeros(grid.half.shape, dtype=np.complex128)
    late_rest = np.zeros(grid.half.shape, dtype=np.complex128)
    for term in _partial_fractions(device, grid.period):
        rest += term.sum_over_aliases(grid.half, 0.0)
        late_rest += term.sum_over_aliases(grid.half, fraction)
    return Aliases(1 / _damping_at_dc(device), _turn(grid.half, fraction), rest.real, late_rest)


def _turn(half: FloatArray, fraction: float) -> ComplexArray:
    """Return how a delay turns a sum with a constant r."""
    return 1 - fraction + fraction * np.exp(-2j * half)


def _damping_at_dc(device: Device) -> Scalars:
    """Return r at DC, N·s/m; where there is none, next to none."""
    of_modes = sum(float(mode.damping) for mode in device.modes)
    least = max(_LEAST_AT_DC * of_modes, 1 / LARGEST)
    return np.maximum(device.damping, least)[()]


class _PartialFraction(NamedTuple):
    """A part of 1/r: weight·p/(θ² − p), with p = root²."""

    root: complex  # Its imaginary part is positive
    weight: complex  # m/(N·s)

    def sum_over_aliases(self, half: FloatArray, fraction: float) -> ComplexArray:
        """Return 4·weight times the sum of e^{−jθ_k·f}/(θ_k² − root²)."""
        decay = 1j * self.root
        back = np.exp(-2j * half)
        in_a_sample = np.exp(decay)
        first = np.exp(decay * (1 - fraction))
        first = first / (1 - back * in_a_sample)
        second = np.exp(decay * fraction)
        second = second / (in_a_sample - back)
        scale = 2j * self.weight / self.root
        return scale * back * (first - second)


def _partial_fractions(device: Device, period: float) -> list[_PartialFraction]:
    """Split 1/r, a ratio of polynomials in x = θ², but for its constant part.

    A mode dissipates b·x²/D with D = x² + (β² − 2κ)·x + κ², β = b·T/m and κ = k·T²/m. Over the
    product of all D,

        1/r = Π D_i/(b_d·Π D_i + Σ_i b_i·x²·Π_{j≠i} D_j)
    """
    modes = [mode for mode in device.modes if mode.mass and mode.damping]
    if not modes:
        return []
    denominators = []
    for mode in modes:
        mass = float(mode.mass)
        beta = float(mode.damping) * period / mass
        kappa = float(mode.stiffness) * period**2 / mass
        middle = beta**2 - 2 * kappa
        denominators.append(Polynomial([kappa**2, middle, 1.0]))
    one = Polynomial([1.0])
    top = math.prod(denominators, start=one)
    bottom = float(_damping_at_dc(device)) * top
    for index, mode in enumerate(modes):
        others = denominators[:index] + denominators[index + 1 :]
        dissipated = Polynomial([0.0, 0.0, float(mode.damping)])
        bottom = bottom + math.prod(others, start=dissipated)
    slope = bottom.deriv()
    parts = []
    for pole in bottom.roots():
        residue = top(pole) / slope(pole)
        if not pole or not residue:
            continue
        root = np.sqrt(complex(pole))
        if root.imag <= 0:
            root = -root
        parts.append(_PartialFraction(root, residue / pole))
    return parts


def _of_table(grid: Warp, device: TabulatedDevice, fraction: float) -> Aliases:
    """Sum a table alias by alias as far as it goes, and its floor beyond in closed form.

    The constant is 1/r of ω itself. The floor's 1/r holds at all other aliases; what the table adds
    to it is summed.
    """
    half = np.maximum(grid.half, _NEAR_DC)
    beyond = 0.0
    if device.floor is not None:
        beyond = 1 / device.floor
    at_omega = _inverse_dissipation(device, 2 * grid.half / grid.period, beyond)
    turns = device.omega[-1] * grid.period / (2 * np.pi)
    last = int(np.ceil(turns)) + 1
    rest = np.zeros(half.shape)
    late_rest = np.zeros(half.shape, dtype=np.complex128)
    for k in range(-last, last + 1):
        if k == 0:
            continue
        angle = 2 * half + 2 * np.pi * k
        inverse = _inverse_dissipation(device, np.abs(angle) / grid.period, beyond)
        part = 4 * (inverse - beyond) / angle**2
        rest += part
        late_rest += part * np.exp(-1j * fraction * angle)
    # The floor at all aliases but ω itself, less the constant there.
    turned = _turn(half, fraction)
    direct = np.exp(-2j * fraction * half)
    of_all = 1 / np.sin(half) ** 2
    of_omega = 1 / half**2
    excess = beyond - at_omega
    rest += excess * (of_all - of_omega)
    late_rest += excess * (turned * of_all - direct * of_omega)
    return Aliases(at_omega, _turn(grid.half, fraction), rest, late_rest)


def _inverse_dissipation(device: TabulatedDevice, omega: FloatArray, beyond: float) -> FloatArray:
    """Return 1/r, m/(N·s), of a table, and what holds beyond; no dissipation makes it huge."""
    real = np.interp(omega, device.omega, device.impedance.real)
    inverse = 1 / np.maximum(real, 1 / LARGEST)
    return np.where(omega > device.omega[-1], beyond, inverse)


def alias_features(loop: Loop) -> FloatArray:
    """Return the ω, rad/s, between DC and Nyquist, where the sums bend.

    Parameters
    ----------
    loop : Loop
        Its device has single numbers.

    Returns
    -------
    ndarray, shape (n,)
        Features above Nyquist where they appear by aliasing.
    """
    device = loop.device
    if isinstance(device, TabulatedDevice):
        angles = device.omega * loop.period
    else:
        offsets = np.concatenate([-_OFFSETS, [0.0], _OFFSETS])
        angles = np.zeros(1)
        for part in _partial_fractions(device, loop.period):
            around = part.root.real + part.root.imag * offsets
            angles = np.concatenate([angles, around])
    turned = np.remainder(angles + np.pi, 2 * np.pi) - np.pi
    folded = np.abs(turned)
    return np.unique(folded) / loop.period
