"""Claims on couplings: what they ask of a device (Eqs 8 to 10), and do to realism."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from percept.haptics import (
    Coupling,
    Device,
    Loop,
    absolute_stability,
    environment_impedance,
    hold,
    magnitude_envelope,
    perceived_impedance,
    required_damping,
)
from percept.haptics.rendering import can_render, needed_damping
from reports.hbfd.devices import (
    DAMPINGS,
    MASSES,
    change_over_band,
    coupled_inside,
    direct_inside,
    most_passed,
    panels,
    relative_width,
    share_true,
)
from reports.hbfd.published import (
    LOOKED_AT,
    THEORETICAL,
    Evidence,
    Published,
    Wall,
    evidence,
)

_SAME = 1e-9  # Relative difference of two ways to one number
_NEAR = 0.01  # Relative difference of stiffness that nobody feels
# Multiples of the tuned coupling: so far that what is left falls in proportion.
_ONCE = 1e3
_TWICE = 1e6
_POINTS = 10_001  # Of ω over the perceivable range
# β/b of the cheapest coupling: where ∂K/∂β = 0, β² − 5.5·bβ − 2b² = 0.
_CHEAPEST = (11 + np.sqrt(153)) / 4
_HIGH = 2  # VE4 and VE5: the paper calls them high and very high impedance


def hold_low_pass(published: Published) -> Evidence:
    """Judge whether Eq. 8 stands for a zero-order hold."""
    period = published.period
    _, top = published.span
    # Both gains fall with ω, the averaging hold's faster: they differ most at the top of the range.
    true = Loop(published.device, published.period, "true")
    average_gain = float(np.abs(hold(published.loop, top)))
    held_gain = float(np.abs(hold(true, top)))
    gain = 1 - average_gain / held_gain
    narrowest = min(relative_width(wall, period) for wall in published.walls)
    held = float(required_damping(true, THEORETICAL).damping)
    average = published.needed()
    cases = [gain < narrowest, held <= average]
    return evidence(cases, gain=gain, held=held, average=average, ratio=held / average)


def poles_unseen(published: Published) -> Evidence:
    """Judge whether Eqs 9 and 10 suffice without a look at the poles."""
    k = float(published.tuned.stiffness)
    b = float(published.tuned.damping)
    # Eq. 10 sees k_c squared and the damping b_c + k_cT/2, which this coupling with −k_c shares.
    mirrored = b + k * published.period
    pole = b / mirrored if mirrored > b else 0.0
    other = mirrored / b if mirrored > b else 0.0
    # Eq. 10 is met at its limit, and a sampled loop asks for more against a rigid wall.
    met = published.needed(published.tuned)
    in_time = _rigid_wall(published, published.tuned)
    cases = [pole <= 1, other <= 1, in_time <= met]
    return evidence(
        cases,
        k=k / 1e3,
        b=b,
        mirrored=mirrored,
        pole=pole,
        other=other,
        met=met,
        in_time=in_time,
    )


def _rigid_wall(published: Published, coupling: Coupling) -> float:
    """Return the device damping that a coupling needs in time, a rigid wall behind it, N·s/m."""
    return float(needed_damping(published.loop, None, coupling=coupling).damping)


def one_coupling(published: Published) -> Evidence:
    """Judge whether Eqs 6 and 12 are about one coupling."""
    period = published.period
    k = THEORETICAL.stiffness
    converted = Coupling(k, THEORETICAL.damping + k * period / 2)
    backward = published.needed()
    tustin = float(required_damping(published.loop, THEORETICAL, discretization="tustin").damping)
    again = float(required_damping(published.loop, converted, discretization="tustin").damping)
    same = [abs(needed - backward) <= _SAME * backward for needed in (tustin, again)]
    return evidence(
        same,
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
    required = required_damping(published.loop, coupling)
    needed = float(required.damping)
    omega = float(required.omega)
    best, least = cheapest_damping(float(coupling.stiffness) * published.period)
    in_time = published.rendered(coupling)
    rendered = [name for name, damping in in_time.items() if damping < needed]
    return evidence(
        needed <= DAMPINGS,
        needed=needed,
        omega=omega,
        best=best,
        least=least,
        rigid=_rigid_wall(published, coupling),
        in_time=in_time,
        rendered=rendered,
    )


def cheapest_damping(stretch: float) -> tuple[float, float]:
    """Return the b_c with which a k_cT asks for the least b_d (Eqs 6, 8 and 10), and that b_d."""
    kappa_root = np.sqrt((8 / _CHEAPEST - 1) / 27)
    needed = 1 / (_CHEAPEST * 2 * kappa_root * (1 + _CHEAPEST))
    return float((_CHEAPEST * needed - 0.5) * stretch), float(needed * stretch)


def worst_case(published: Published) -> Evidence:
    """Say why nobody can judge that a worst-case design made the system unstable."""
    criterion = absolute_stability(published.loop, THEORETICAL)
    in_time = published.rendered(THEORETICAL)
    return evidence(
        None,
        margin=criterion.smallest_margin,
        omega=criterion.binding_omega,
        average=published.needed(),
        rigid=_rigid_wall(published, THEORETICAL),
        in_time=in_time,
        most=max(in_time.values()),
    )


def friction_ignored(published: Published) -> Evidence:
    """Say what friction and an operator could do to a loop."""
    grows = []
    for wall in published.walls:
        found = can_render(published.loop, wall.environment, coupling=THEORETICAL)
        if found.verdict == "cannot":
            grows.append(wall.name)
    return evidence(None, grows=grows, most=max(published.rendered(THEORETICAL).values()))


def stability_costs(published: Published) -> Evidence:
    """Judge whether what makes the loop stabler makes the display less transparent."""
    wall = published.softest_first[-1]
    undamped = Coupling(THEORETICAL.stiffness, 0.0)
    needed = []
    felt = []
    for coupling in (THEORETICAL, published.tuned, undamped):
        needed.append(published.rendered(coupling)[wall.name])
        felt.append(published.through_coupling(wall, coupling)[0])
    before, softer, less_damped = needed
    stiff, soft, same = felt
    # The same stiffness from less damping is stabler, and no less transparent in it.
    keeps_stiffness = less_damped < before and same >= stiff * (1 - _NEAR)
    return evidence(
        [softer < before and soft < stiff, not keeps_stiffness],
        wall=wall.name,
        before=before,
        softer=softer,
        less_damped=less_damped,
        stiff=stiff,
        soft=soft,
        same=same,
    )


def perception_limited(published: Published) -> Evidence:
    """Say why a reference outside its own limits shows no limit of perception."""
    wall, _ = published.drawn[-1]
    low, high = wall.stiffness
    width = (high - low) / wall.k
    return evidence(None, wall=wall.name, high=high, above=wall.k / high - 1, width=width)


def coupling_to_infinity(published: Published) -> Evidence:
    """Judge whether Eq. 13 is the limit of Eq. 11 for an infinitely stiff coupling."""
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
    """Return the largest relative difference of Eqs 11 and 13, the tuned coupling multiplied."""
    omega = published.omega(_POINTS)
    tuned = published.tuned
    coupling = Coupling(tuned.stiffness * times, tuned.damping * times)
    largest = 0.0
    for wall in published.walls:
        direct = perceived_impedance(published.loop, omega, wall.environment)
        coupled = perceived_impedance(published.loop, omega, wall.environment, coupling=coupling)
        gaps = np.abs(coupled / direct - 1)
        largest = max(largest, float(gaps.max()))
    return largest


def direct_rendering(published: Published) -> Evidence:
    """Judge stable interaction with the reference without a coupling."""
    device_damping = float(published.device.damping)
    directly = published.rendered()
    passive = []
    each = {}
    paper = []
    radii = {}
    for wall in published.walls:
        each[wall.name] = directly[wall.name]
        # Re Z_h of Eqs 7, 8 and 13 is least at DC.
        paper.append(wall.k * published.period / 2 - wall.b)
        radii[wall.name] = _pole_radius(published, wall)
        if device_damping > each[wall.name]:
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


def coupling_unnoticed(published: Published) -> Evidence:
    """Judge whether the coupling does not matter at very low impedance."""
    panel, _, _ = panels(published)
    fraction, device = most_passed(published, panel)
    largest = float(change_over_band(published, panel, published.device).max())
    return evidence(
        [fraction == 0, largest < 1],
        fraction=fraction,
        largest=largest,
        device=device,
    )


def suits_high(published: Published) -> Evidence:
    """Judge whether a coupling suits high impedance and harms low."""
    felt = {}
    losses = {}
    inside = []
    for wall in published.softest_first:
        stiffness, _ = published.through_coupling(wall)
        felt[wall.name] = stiffness
        losses[wall.name] = 1 - stiffness / wall.k
        low, high = wall.stiffness
        if low <= stiffness <= high:
            inside.append(wall.name)
    parts = list(losses.values())
    falls = [soft >= stiff for soft, stiff in pairwise(parts)]
    highest = list(losses)[-_HIGH:]
    cases = [name in inside for name in highest]
    kept = [name for name in highest if name in inside]
    return evidence(
        cases + falls,
        high=kept,
        losses=losses,
        inside=inside,
        most=parts[-1],
        felt=felt,
    )


def always_smaller(published: Published) -> Evidence:
    """Judge whether what is felt through the coupling is always below the virtual environment."""
    shares = {}
    cases = []
    for wall in published.walls:
        fraction = _share_below(published, wall)
        shares[wall.name] = fraction
        cases += [fraction > 0, fraction == 1.0]
    least = min(published.walls, key=lambda wall: shares[wall.name])
    with_it = published.felt(LOOKED_AT, least.environment, coupling=published.tuned)
    alone = np.abs(environment_impedance(published.loop, LOOKED_AT, least.environment))
    always = [name for name, fraction in shares.items() if fraction == 1.0]
    others = dict(shares)
    del others[least.name]
    return evidence(
        cases,
        always=always,
        shares=shares,
        worst=least.name,
        least=shares[least.name],
        others=others,
        with_it=float(with_it),
        alone=float(alone),
    )


def _share_below(published: Published, wall: Wall) -> float:
    """Return the share of the range over which |Z_h_vc| is below |Z_e|."""
    omega = published.omega()
    rendered = np.abs(environment_impedance(published.loop, omega, wall.environment))
    felt = published.felt(omega, wall.environment, coupling=published.tuned)
    return float((felt < rendered).mean())


def lower_or_medium(published: Published) -> Evidence:
    """Judge whether the coupling takes low and medium impedances out of the boundaries."""
    spoilt, _ = _spoilt(published)
    coupled = {}
    direct = {}
    for wall in published.softest_first[:-_HIGH]:
        coupled[wall.name] = share_true(published, wall, coupled_inside)
        direct[wall.name] = share_true(published, wall, direct_inside)
    cases = [fraction < 1 for fraction in coupled.values()]
    cases += [name in spoilt for name in coupled]
    lost = list(dict.fromkeys(spoilt))
    return evidence(cases, lost=lost, coupled=coupled, direct=direct, least=min(coupled.values()))


def affects_realism(published: Published) -> Evidence:
    """Judge whether a static coupling can spoil realism, by the next user's boundary."""
    spoilt, tried = _spoilt(published)
    names = list(dict.fromkeys(spoilt))
    return evidence([bool(spoilt)], names=names, spoilt=len(spoilt), tried=tried)


@lru_cache(maxsize=1)  # Two claims ask for the same
def _spoilt(published: Published) -> tuple[list[str], int]:
    """Return the environments that only the coupling takes out, once a device, and all tried."""
    omega = published.omega(_POINTS)
    masses = (0.0, *MASSES[::14].tolist())
    spoilt = []
    for wall, (k, b) in zip(published.walls, published.next_user, strict=True):
        for mass in masses:
            device = Device(mass, published.device.damping)
            lower, upper = magnitude_envelope(Loop(device, published.period), omega, k, b)
            inside = []
            for coupling in (None, published.tuned):
                felt = published.felt(omega, wall.environment, coupling=coupling, device=device)
                inside.append(bool(((lower <= felt) & (felt <= upper)).all()))
            if inside == [True, False]:
                spoilt.append(wall.name)
    return spoilt, len(published.walls) * len(masses)
