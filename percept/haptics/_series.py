"""Two elements in series, Z₁Z₂/(Z₁ + Z₂), as the damping and stiffness the pair shows at each ω."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from percept.haptics._arrays import FloatArray, Scalars, ratio, times
from percept.haptics._warp import Warp


@dataclass(frozen=True)
class Element:
    """m·s + b + k/s; plain arrays that broadcast, signs free."""

    stiffness: Scalars
    damping: Scalars
    mass: Scalars = 0.0


@dataclass(frozen=True)
class Shown:
    """What an impedance shows at each ω: damping Re Z and stiffness −Ω·Im Z."""

    stiffness: FloatArray
    damping: FloatArray


def series(warp: Warp, first: Element, second: Element) -> Shown:
    """Return what Z₁Z₂/(Z₁ + Z₂) shows; `second` must have no mass.

    Z₁Z₂/(Z₁ + Z₂) = w₁Z₁ + w₂Z₂ with w₁ = |Z₂|²/|Z₁ + Z₂|², w₂ = |Z₁|²/|Z₁ + Z₂|²: both weights are
    positive, so a passive pair keeps every digit of its damping. Where the pair is at an undamped
    resonance the stiffness is +inf (the pole has no sign of its own).
    """
    k1, b1, m1 = first.stiffness, first.damping, first.mass
    k2, b2 = second.stiffness, second.damping
    at_dc, at_nyquist = warp.sin == 0, warp.cos == 0
    edge = at_dc | at_nyquist
    # The general form is evaluated at the ends with a dummy angle and overwritten there by the limit.
    sin, cos = np.where(edge, 0.5, warp.sin), np.where(edge, 0.5, warp.cos)
    # Z·sin h·cos h is finite everywhere.
    spring, inertia = (warp.period / 2) * cos**2, (2 / warp.period) * sin**2
    x1, x2 = np.multiply(m1, inertia) - np.multiply(k1, spring), -np.multiply(k2, spring)
    r1, r2 = np.multiply(b1, sin * cos), np.multiply(b2, sin * cos)
    total = np.hypot(r1 + r2, x1 + x2)
    w1 = ratio(np.hypot(r2, x2), total, empty=0.0) ** 2
    w2 = ratio(np.hypot(r1, x1), total, empty=0.0) ** 2
    damping = times(w1, b1) + times(w2, b2)
    stiffness = times(w1, np.subtract(k1, np.multiply(m1, (2 * sin / (warp.period * cos)) ** 2))) + times(
        w2, k2
    )
    stiffness = np.where(np.isnan(stiffness), np.inf, stiffness)
    if not edge.any():
        return Shown(stiffness=stiffness, damping=damping)

    dc1, dc2 = _limit_weights((k1, k2), (b1, b2))
    end1, end2 = _limit_weights((b1, b2), (k1, k2))
    # A mass, where there is one, is immovable at Nyquist: only the second element is left.
    held = np.asarray(m1) > 0
    at_end = np.where(held, k2 - ratio(np.square(b2), m1, empty=0.0), times(end1, k1) + times(end2, k2))
    damping_at_end = np.where(held, b2, times(end1, b1) + times(end2, b2))
    stiffness = np.where(at_dc, times(dc1, k1) + times(dc2, k2), stiffness)
    damping = np.where(at_dc, times(dc1, b1) + times(dc2, b2), damping)
    return Shown(
        stiffness=np.where(at_nyquist, at_end, stiffness),
        damping=np.where(at_nyquist, damping_at_end, damping),
    )


def _limit_weights(
    leading: tuple[Scalars, Scalars], following: tuple[Scalars, Scalars]
) -> tuple[FloatArray, FloatArray]:
    """Return w₁, w₂ where one kind of parameter outgrows all others: the leading one, or what follows it."""
    led = np.add(*leading) > 0
    first, second = np.where(led, leading[0], following[0]), np.where(led, leading[1], following[1])
    total = first + second
    return ratio(second, total, empty=0.0) ** 2, ratio(first, total, empty=0.0) ** 2


def reactance(warp: Warp, stiffness: FloatArray) -> FloatArray:
    """Return Im Z = −k/Ω of a shown stiffness."""
    return -times(stiffness, warp.inverse_rate)
