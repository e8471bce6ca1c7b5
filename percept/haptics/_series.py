"""Two elements in series, Z₁Z₂/(Z₁ + Z₂), as the damping and stiffness the pair shows at each ω."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from percept.haptics._arrays import FloatArray, Scalars, ratio, times
from percept.haptics._warp import Warp


@dataclass(frozen=True)
class Element:
    """m·s + b + k/s, of numbers or arrays that broadcast."""

    stiffness: Scalars
    damping: Scalars
    mass: Scalars = 0.0


@dataclass(frozen=True)
class Shown:
    """What an impedance shows at each ω: damping Re Z and stiffness −Ω·Im Z."""

    stiffness: FloatArray
    damping: FloatArray


def series(warp: Warp, first: Element, second: Element) -> Shown:
    """Return what Z₁Z₂/(Z₁ + Z₂) shows; `second` has no mass.

    Z₁Z₂/(Z₁ + Z₂) = a₂²Z₁ + a₁²Z₂ with aᵢ = |Zᵢ|/|Z₁ + Z₂|: both weights are positive, so a passive pair
    keeps every digit of its damping. In the stiffness what springs and masses add to the weights is drawn
    together to k₁k₂(k₁ + k₂): left in them, it would be a difference of large numbers near a resonance,
    k₁ = −k₂. At an undamped resonance the stiffness is +inf (a pole has no sign).
    """
    r1, x1 = scaled_parts(warp, first)
    r2, x2 = scaled_parts(warp, second)
    total = np.hypot(r1 + r2, x1 + x2)
    w1 = ratio(np.hypot(r2, x2), total, empty=0.0) ** 2
    w2 = ratio(np.hypot(r1, x1), total, empty=0.0) ** 2
    at_dc, at_nyquist = warp.sin == 0, warp.cos == 0
    # The rate at the ends is not used there; 0 keeps it finite.
    inertia = np.multiply(first.mass, np.where(at_nyquist, 0.0, warp.rate) ** 2)
    with np.errstate(invalid="ignore"):
        k1, k2 = first.stiffness - inertia, np.asarray(second.stiffness)
        stiffness = (
            times(ratio(r2, total, empty=0.0) ** 2, k1)
            + times(ratio(r1, total, empty=0.0) ** 2, k2)
            + times(ratio(x1, total, empty=0.0) * ratio(x2, total, empty=0.0), k1 + k2)
        )
    pole = (total == 0) & (x1 != 0)
    stiffness = np.where(np.isfinite(stiffness) & ~pole, stiffness, np.inf)
    damping = times(w1, first.damping) + times(w2, second.damping)
    if not (at_dc | at_nyquist).any():
        return Shown(stiffness=stiffness, damping=damping)

    # Next to Nyquist a mass takes b₂²/m off the stiffness.
    heavy = np.asarray(first.mass) > 0
    taken = np.where(heavy, ratio(np.square(second.damping), first.mass, empty=0.0), 0.0)
    dc, nyquist = end_shares(first, second)
    for there, (share1, share2), less in ((at_dc, dc, 0.0), (at_nyquist, nyquist, taken)):
        end = share1**2 * first.stiffness + share2**2 * second.stiffness - less
        stiffness = np.where(there, end, stiffness)
        damping = np.where(there, share1**2 * first.damping + share2**2 * second.damping, damping)
    return Shown(stiffness=stiffness, damping=damping)


def scaled_parts(warp: Warp, element: Element) -> tuple[FloatArray, FloatArray]:
    """Return the parts of Z·sin h·cos h, which is finite from DC to Nyquist."""
    inertia = np.multiply(element.mass, (2 / warp.period) * warp.sin**2)
    spring = np.multiply(element.stiffness, (warp.period / 2) * warp.cos**2)
    return np.multiply(element.damping, warp.sin * warp.cos), inertia - spring


Shares = tuple[FloatArray, FloatArray]


def end_shares(first: Element, second: Element) -> tuple[Shares, Shares]:
    """Return Z₂/(Z₁ + Z₂) and Z₁/(Z₁ + Z₂) at DC and at Nyquist, where one kind of parameter leads.

    At DC stiffness outgrows damping, at Nyquist damping outgrows stiffness and a mass outgrows both.
    """
    stiffnesses, dampings = (first.stiffness, second.stiffness), (first.damping, second.damping)
    dc = _shares(stiffnesses, dampings)
    light2, light1 = _shares(dampings, stiffnesses)
    heavy = np.asarray(first.mass) > 0
    return dc, (np.where(heavy, 0.0, light2), np.where(heavy, 1.0, light1))


def _shares(leading: tuple[Scalars, Scalars], following: tuple[Scalars, Scalars]) -> Shares:
    led = np.add(*leading) > 0
    first, second = np.where(led, leading[0], following[0]), np.where(led, leading[1], following[1])
    return ratio(second, first + second, empty=0.0), ratio(first, first + second, empty=0.0)


def reactance(warp: Warp, stiffness: FloatArray) -> FloatArray:
    """Return Im Z = −k/Ω of a shown stiffness."""
    return -times(stiffness, warp.inverse_rate)
