"""Claims on stability: Eqs 8 to 10 and 13, and the couplings of section 2.3."""

from __future__ import annotations

import numpy as np

from percept.haptics import (
    Coupling,
    absolute_stability,
    hold,
    perceived_impedance,
    required_damping,
)
from percept.haptics.limits import best_coupling_damping, passivity_damping
from percept.reproduce.devices import DAMPINGS, relative_width
from percept.reproduce.evidence import Evidence, evidence, undecided
from percept.reproduce.published import THEORETICAL, Published, Wall

__all__ = [
    "coupling_to_infinity",
    "direct_rendering",
    "fig_4_theoretical",
    "fig_4_tuned",
    "hold_low_pass",
    "one_coupling",
    "poles_unseen",
    "worst_case",
]

_SAME = 1e-9  # Relative difference of two ways to one number
# Multiples of the tuned coupling: so far that what is left falls in proportion.
_ONCE = 1e3
_TWICE = 1e6
_POINTS = 2001  # Of ω over the perceivable range


def hold_low_pass(published: Published) -> Evidence:
    """Judge whether Eq. 8 stands for a zero-order hold."""
    period = published.period
    _, top = published.span
    # Both gains fall with ω, the averaging hold's faster: they differ most at the top of the range.
    average_gain = float(np.abs(hold(top, period)))
    held_gain = float(np.abs(hold(top, period, kind="true")))
    gain = 1 - average_gain / held_gain
    narrowest = min(relative_width(wall, period) for wall in published.walls)
    held = float(required_damping(THEORETICAL, period, hold="true").damping)
    average = published.needed()
    cases = [gain < narrowest, held <= average]
    return evidence(cases, gain=gain, held=held, average=average, ratio=held / average)


def poles_unseen(published: Published) -> Evidence:
    """Judge whether Eqs 9 and 10 suffice without a look at the poles."""
    k = float(published.tuned.stiffness)
    b = float(published.tuned.damping)
    # Eq. 10 sees k_c squared and the damping b_c + k_cT/2, which this coupling with −k_c shares.
    mirrored = b + k * published.period
    own = b / mirrored if mirrored > b else 0.0
    other = mirrored / b if mirrored > b else 0.0
    cases = [own <= 1, other <= 1]
    return evidence(cases, k=k / 1e3, b=b, mirrored=mirrored, own=own, other=other)


def one_coupling(published: Published) -> Evidence:
    """Judge whether Eqs 6 and 12 are about one coupling."""
    period = published.period
    k = THEORETICAL.stiffness
    converted = Coupling(k, THEORETICAL.damping + k * period / 2)
    backward = published.needed()
    tustin = float(required_damping(THEORETICAL, period, discretization="tustin").damping)
    again = float(required_damping(converted, period, discretization="tustin").damping)
    return evidence(
        [abs(tustin - backward) <= _SAME * backward, abs(again - backward) <= _SAME * backward],
        b=THEORETICAL.damping,
        converted=converted.damping,
        backward=backward,
        tustin=tustin,
        ratio=tustin / backward,
    )


def fig_4_theoretical(published: Published) -> Evidence:
    """Judge Fig. 4's theoretical coupling."""
    return _stable_with(published, THEORETICAL)


def fig_4_tuned(published: Published) -> Evidence:
    """Judge the coupling found by tuning."""
    return _stable_with(published, published.tuned)


def _stable_with(published: Published, coupling: Coupling) -> Evidence:
    required = required_damping(coupling, published.period)
    needed = float(required.damping)
    omega = float(required.omega)
    best, least = best_coupling_damping(float(coupling.stiffness), published.period)
    return evidence(needed <= DAMPINGS, needed=needed, omega=omega, best=best, least=least)


def worst_case(published: Published) -> Evidence:
    """Say why nobody can judge that a worst-case design made the system unstable."""
    stability = absolute_stability(published.device, THEORETICAL, published.period)
    return undecided(margin=stability.smallest_margin, omega=stability.binding_omega)


def coupling_to_infinity(published: Published) -> Evidence:
    """Judge whether Eq. 13 is the limit of Eq. 11 for an endless coupling."""
    gap = _largest_gap(published, _ONCE)
    smaller = _largest_gap(published, _TWICE)
    needed = published.needed(published.tuned)
    # A difference that vanishes does so in proportion to 1/Z_c.
    fall = gap / smaller
    return evidence(
        [fall > 0.9 * _TWICE / _ONCE],
        once=_ONCE,
        twice=_TWICE,
        gap=gap,
        smaller=smaller,
        fall=fall,
        needed=needed,
        asked=needed * _ONCE,
    )


def _largest_gap(published: Published, times: float) -> float:
    """Return the largest relative difference of Eqs 11 and 13 with a multiple of the tuned coupling."""
    omega = published.omega(_POINTS)
    device = published.device
    period = published.period
    tuned = published.tuned
    coupling = Coupling(tuned.stiffness * times, tuned.damping * times)
    largest = 0.0
    for wall in published.walls:
        direct = perceived_impedance(omega, device, wall.environment, period)
        coupled = perceived_impedance(omega, device, wall.environment, period, coupling=coupling)
        largest = max(largest, float(np.abs(coupled / direct - 1).max()))
    return largest


def direct_rendering(published: Published) -> Evidence:
    """Judge stable interaction with the reference without a coupling."""
    own = float(published.device.damping)
    passive = []
    each = {}
    paper = []
    radii = {}
    for wall in published.walls:
        colgate, of_paper = passivity_damping(wall.environment, published.period)
        each[wall.name] = float(colgate)
        paper.append(float(of_paper))
        radii[wall.name] = _pole_radius(published, wall)
        if own > colgate:
            passive.append(wall.name)
    cases = [name in passive for name in each]
    # Stable with every passive hand, and stable without one.
    cases += [radius < 1 for radius in radii.values()]
    return evidence(
        cases,
        fine=passive,
        each=each,
        largest=max(each.values()),
        paper=paper,
        largest_paper=max(paper),
        radii=radii,
        radius=max(radii.values()),
    )


def _pole_radius(published: Published, wall: Wall) -> float:
    """Return the largest modulus of the poles of device and rendered wall without a hand."""
    # Z_d + ZOH·Z_e = 0 (Eqs 5, 7, 8), multiplied by 2z·s·(z + 1)² with s = (2/T)(z − 1)/(z + 1).
    z = np.poly1d([1.0, 0.0])
    over = 2 / published.period * (z - 1)
    under = z + 1
    device = published.device
    inertia = float(device.mass) * over**2 + float(device.damping) * over * under
    rendered = wall.b * over * under + wall.k * under**2
    characteristic = 2 * z * inertia + under * rendered
    return float(np.abs(characteristic.roots).max())
