"""What a device dissipates at all aliases of a frequency together.

A sampled loop sees the device at ω_k = ω + 2πk/T. What counts is the sum over all k of
1/(ω_k²·Re Z_d(jω_k)), and with a fraction f of a sample as delay the same sum with e^{−jω_k·fT}.
Here Z_d is the device in continuous time: no Tustin's method.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial

from percept.haptics.arrays import LARGEST, ComplexArray, FloatArray, Scalars
from percept.haptics.axis import Warp
from percept.haptics.records import AnyDevice, Device, TabulatedDevice

__all__ = ["Aliases", "alias_features", "aliases"]

# Of all damping, what a device without any at DC is given: the sums have a pole there.
_LEAST = 1e-12
# Half an angle below which the sums of a table hardly move: nearer to DC they would cancel.
_NEAR_DC = 1e-3
# Where a feature is looked at, in its widths to either side.
_OFFSETS = np.geomspace(1e-2, 1e2, 25)


class Aliases(NamedTuple):
    """The sums times 4/T², in two parts; late is with the delay, rest without.

    They are own/sin² h + rest and own·turn/sin² h + late, with h = ωT/2.
    """

    own: Scalars  # m/(N·s); of a rigid device 1/b_d, and all there is
    turn: ComplexArray  # 1 − f + f·e^{−2jh}
    rest: FloatArray  # m/(N·s)
    late: ComplexArray


def aliases(grid: Warp, device: AnyDevice, fraction: float) -> Aliases:
    """Return the sums over the aliases of each ω.

    Parameters
    ----------
    grid : Warp
        Angles of ω.
    device : Device or TabulatedDevice
        Of single numbers; the damping of a rigid device may be an array. Above a table's end its
        floor holds, and without a floor those aliases count for nothing.
    fraction : float
        f, of a sample, below 1.

    Returns
    -------
    Aliases
    """
    turn = 1 - fraction + fraction * np.exp(-2j * grid.half)
    if isinstance(device, TabulatedDevice):
        return _of_table(grid, device, fraction, turn)
    rest = np.zeros(grid.half.shape, dtype=np.complex128)
    late = np.zeros(grid.half.shape, dtype=np.complex128)
    for term in _terms(device, grid.period):
        rest += term.sum_over_aliases(grid.half, 0.0)
        late += term.sum_over_aliases(grid.half, fraction)
    return Aliases(1 / _base(device), turn, rest.real, late)


def _base(device: Device) -> Scalars:
    """Return the damping at DC, N·s/m; where there is none, next to none."""
    others = sum(float(mode.damping) for mode in device.modes)
    least = max(_LEAST * others, 1 / LARGEST)
    return np.maximum(device.damping, least)[()]


class _Term(NamedTuple):
    """A partial fraction of 1/Re Z_d in x = (ωT)²: weight·p/(x − p), with p = root²."""

    root: complex  # Its imaginary part is positive
    weight: complex  # m/(N·s)

    def sum_over_aliases(self, half: FloatArray, fraction: float) -> ComplexArray:
        """Return 4·weight times the sum of e^{−jθ_k·f}/(θ_k² − root²) over θ_k = 2h + 2πk."""
        back = np.exp(-2j * half)
        whole = np.exp(1j * self.root)
        first = np.exp(1j * self.root * (1 - fraction)) / (1 - back * whole)
        second = np.exp(1j * self.root * fraction) / (whole - back)
        return (2j * self.weight / self.root) * back * (first - second)


def _terms(device: Device, period: float) -> list[_Term]:
    """Split 1/Re Z_d = Π D_i/(b_d·Π D_i + Σ b_i·x²·Π D_j) into partial fractions.

    D_i = x² + (β² − 2κ)·x + κ², with β = b_i·T/m_i and κ = k_i·T²/m_i.
    """
    modes = [mode for mode in device.modes if mode.mass and mode.damping]
    if not modes:
        return []
    factors = []
    for mode in modes:
        beta = float(mode.damping) * period / float(mode.mass)
        kappa = float(mode.stiffness) * period**2 / float(mode.mass)
        factors.append(np.array([kappa**2, beta**2 - 2 * kappa, 1.0]))
    top = _product(factors)
    bottom = float(_base(device)) * top
    for index, mode in enumerate(modes):
        others = _product(factors[:index] + factors[index + 1 :])
        own = np.convolve([0.0, 0.0, float(mode.damping)], others)
        bottom = bottom + np.asarray(own)
    slope = polynomial.polyder(bottom)
    terms = []
    for place in polynomial.polyroots(bottom):
        weight = polynomial.polyval(place, top) / polynomial.polyval(place, slope)
        if place and weight:
            root = np.sqrt(complex(place))
            terms.append(_Term(root if root.imag > 0 else -root, weight / place))
    return terms


def _product(factors: list[FloatArray]) -> FloatArray:
    """Return the product of polynomials, lowest power first."""
    product: FloatArray = np.ones(1)
    for factor in factors:
        product = np.asarray(np.convolve(product, factor))
    return product


def _of_table(grid: Warp, device: TabulatedDevice, fraction: float, turn: ComplexArray) -> Aliases:
    """Sum a table alias by alias as far as it goes, and its floor beyond in closed form."""
    half = np.maximum(grid.half, _NEAR_DC)
    beyond = 0.0 if device.floor is None else 1 / device.floor
    own = _admitted(device, 2 * grid.half / grid.period, beyond)
    most = int(np.ceil(device.omega[-1] * grid.period / (2 * np.pi))) + 1
    rest = np.zeros(half.shape)
    late = np.zeros(half.shape, dtype=np.complex128)
    for alias in range(-most, most + 1):
        if alias:
            angle = 2 * half + 2 * np.pi * alias
            admitted = _admitted(device, np.abs(angle) / grid.period, beyond)
            part = 4 * (admitted - beyond) / angle**2
            rest += part
            late += part * np.exp(-1j * fraction * angle)
    direct = np.exp(-2j * fraction * half)
    turned = 1 - fraction + fraction * np.exp(-2j * half)
    rest += (beyond - own) * (1 / np.sin(half) ** 2 - 1 / half**2)
    late += (beyond - own) * (turned / np.sin(half) ** 2 - direct / half**2)
    return Aliases(own, turn, rest, late)


def _admitted(device: TabulatedDevice, omega: FloatArray, beyond: float) -> FloatArray:
    """Return 1/Re Z_d, m/(N·s), of a table; a device that dissipates nothing makes it huge."""
    real = np.interp(omega, device.omega, device.impedance.real)
    inverse = 1 / np.maximum(real, 1 / LARGEST)
    return np.where(omega > device.omega[-1], beyond, inverse)


def alias_features(device: AnyDevice, period: float) -> FloatArray:
    """Return the ω, rad/s, between DC and Nyquist, where the sums bend.

    Parameters
    ----------
    device : Device or TabulatedDevice
        Of single numbers.
    period : float
        Sampling period T, s.

    Returns
    -------
    ndarray, shape (n,)
        Features above Nyquist where they appear by aliasing.
    """
    if isinstance(device, TabulatedDevice):
        angles = device.omega * period
    else:
        offsets = np.concatenate([-_OFFSETS, [0.0], _OFFSETS])
        parts = [term.root.real + term.root.imag * offsets for term in _terms(device, period)]
        angles = np.concatenate([*parts, np.zeros(1)])
    folded = np.abs(np.remainder(angles + np.pi, 2 * np.pi) - np.pi)
    return np.unique(folded) / period
