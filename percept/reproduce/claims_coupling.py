"""Claims on the coupling: what it asks of the device, and what it does to realism."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from percept.haptics import (
    Coupling,
    Device,
    absolute_stability,
    environment_impedance,
    hold,
    magnitude_envelope,
    perceived_impedance,
    required_damping,
)
from percept.haptics.limits import best_coupling_damping, passivity_damping
from percept.reproduce.devices import (
    DAMPINGS,
    MASSES,
    coupled_inside,
    direct_inside,
    relative_width,
    share_true,
)
from percept.reproduce.published import LOOKED_AT, THEORETICAL, Array, Evidence, Published, Wall
from percept.reproduce.squares import cells, envelope_squares, felt_square, rendered_square, share

_SAME = 1e-9
# Times the tuned coupling: far enough that what is left falls in proportion.
_ONCE = 1e3
_TWICE = 1e6
_POINTS = 2001  # of ω over the perceivable range


def hold_low_pass(published: Published) -> Evidence:
    """Judge whether Eq. 8 stands for a zero-order hold."""
    period = published.period
    _, top = published.span
    # Both gains fall with ω, the averaging hold's faster: they differ most at the top of the range.
    average = float(np.abs(hold(top, period)))
    held = float(np.abs(hold(top, period, kind="true")))
    gain = 1 - average / held
    narrowest = min(relative_width(wall, period) for wall in published.walls)
    asked = float(required_damping(THEORETICAL, period, hold="true").damping)
    needed = published.needed()
    return {
        "cases": [gain < narrowest, asked <= needed],
        "gain": gain,
        "held": asked,
        "average": needed,
        "ratio": asked / needed,
    }


def coupling_to_infinity(published: Published) -> Evidence:
    """Judge whether Eq. 13 is the limit of Eq. 11 for an endless coupling."""
    gap = _largest_gap(published, _ONCE)
    smaller = _largest_gap(published, _TWICE)
    needed = published.needed(published.tuned)
    # A difference that vanishes does so in proportion to 1/Z_c.
    fall = gap / smaller if smaller else np.inf
    return {
        "cases": [fall > 0.9 * _TWICE / _ONCE],
        "once": _ONCE,
        "twice": _TWICE,
        "gap": gap,
        "smaller": smaller,
        "fall": fall,
        "needed": needed,
        "asked": needed * _ONCE,
    }


def _largest_gap(published: Published, times: float) -> float:
    """Return the largest relative difference of Eqs 11 and 13 with a multiple of the tuned coupling."""
    omega = published.omega(_POINTS)
    tuned = published.tuned
    coupling = Coupling(tuned.stiffness * times, tuned.damping * times)
    gaps = []
    for wall in published.walls:
        direct, coupled = (
            perceived_impedance(
                omega, published.device, wall.environment, published.period, coupling=each
            )
            for each in (None, coupling)
        )
        gaps.append(float(np.abs(coupled / direct - 1).max()))
    return max(gaps)


def poles_unseen(published: Published) -> Evidence:
    """Judge whether Eqs 9 and 10 suffice without a look at the poles."""
    k, b = float(published.tuned.stiffness), float(published.tuned.damping)
    stretch = k * published.period
    # Eq. 10 sees k_c squared and the damping b_c + k_cT/2, which these two share; 1/Z_c has this
    # pole.
    mirrored = b + stretch
    own, other = (b / mirrored, mirrored / b) if stretch else (0.0, 0.0)
    return {
        "cases": [own <= 1, other <= 1],
        "k": k / 1e3, "b": b, "mirrored": mirrored, "own": own, "other": other,
    }  # fmt: skip


def one_coupling(published: Published) -> Evidence:
    """Judge whether Eqs 6 and 12 are about one coupling."""
    period, backward = published.period, published.needed()
    converted = Coupling(
        THEORETICAL.stiffness, THEORETICAL.damping + THEORETICAL.stiffness * period / 2
    )
    tustin, again = (
        float(required_damping(coupling, period, discretization="tustin").damping)
        for coupling in (THEORETICAL, converted)
    )
    return {
        "cases": [abs(needed - backward) <= _SAME * backward for needed in (tustin, again)],
        "b": THEORETICAL.damping, "converted": converted.damping,
        "backward": backward, "tustin": tustin, "ratio": tustin / backward,
    }  # fmt: skip


def fig_4_theoretical(published: Published) -> Evidence:
    """Judge Fig. 4's theoretical coupling."""
    return _stable_with(published, THEORETICAL)


def fig_4_tuned(published: Published) -> Evidence:
    """Judge the coupling found by tuning."""
    return _stable_with(published, published.tuned)


def _stable_with(published: Published, coupling: Coupling) -> Evidence:
    record = required_damping(coupling, published.period)
    best, least = best_coupling_damping(float(coupling.stiffness), published.period)
    return {
        "cases": float(record.damping) <= DAMPINGS,
        "needed": float(record.damping), "omega": float(record.omega),
        "best": best, "least": least,
    }  # fmt: skip


def worst_case(published: Published) -> Evidence:
    """Say why nobody can judge that a worst-case design made the system unstable."""
    found = absolute_stability(published.device, THEORETICAL, published.period)
    return {"margin": found.smallest_margin, "omega": found.binding_omega}


def direct_rendering(published: Published) -> Evidence:
    """Judge stable interaction with the reference without a coupling."""
    own = float(published.device.damping)
    needs = [passivity_damping(wall.environment, published.period) for wall in published.walls]
    colgate, paper = (
        {wall.name: float(need) for wall, need in zip(published.walls, column, strict=True)}
        for column in zip(*needs, strict=True)
    )
    radii = {wall.name: pole_radius(published, wall) for wall in published.walls}
    passive = [own > needed for needed in colgate.values()]
    stable = [radius < 1 for radius in radii.values()]
    return {
        "cases": [*passive, *stable],
        "radii": radii, "radius": max(radii.values()),
        "largest": max(colgate.values()), "largest_paper": max(paper.values()),
        "fine": [name for name, needed in colgate.items() if own > needed],
        "each": colgate, "paper": list(paper.values()),
    }  # fmt: skip


def pole_radius(published: Published, wall: Wall) -> float:
    """Return the largest modulus of the poles of device and rendered wall without a hand."""
    # Z_d + ZOH·Z_e = 0 (Eqs 5, 7, 8), multiplied by 2z·s·(z + 1)² with s = (2/T)(z − 1)/(z + 1).
    z = np.poly1d([1.0, 0.0])
    over = 2 / published.period * (z - 1)
    under = z + 1
    device = published.device
    inertia = float(device.mass) * over**2 + float(device.damping) * over * under
    rendered = wall.b * over * under + wall.k * under**2
    return float(np.abs((2 * z * inertia + under * rendered).roots).max())


def suits_high(published: Published) -> Evidence:
    """Judge whether a coupling suits high impedance and harms low."""
    felt = {wall.name: published.through_coupling(wall)[0] for wall in published.walls}
    order = sorted(published.walls, key=lambda wall: wall.k)
    loss = {wall.name: float(1 - felt[wall.name] / wall.k) for wall in order}
    inside = [w.name for w in order if w.stiffness[0] <= felt[w.name] <= w.stiffness[1]]
    high = [wall.name for wall in order[-2:]]
    told = ", ".join(f"{part:.2%} ({name})" for name, part in loss.items())
    falls = [soft >= stiff for soft, stiff in pairwise(loss.values())]
    return {
        "cases": [*(name in inside for name in high), *falls],
        "high": [name for name in high if name in inside],
        "told": f"The stiffness lost does not rise with the wall’s: {told}."
        if any(falls)
        else f"The opposite is true: the coupling takes {told} of the stiffness, more the stiffer the wall.",
        "inside": inside, "most": loss[order[-1].name], "felt": felt,
    }  # fmt: skip


def always_smaller(published: Published) -> Evidence:
    """Judge whether what is felt through the coupling is always below the virtual environment."""
    span, period = published.span, published.period
    device, shares = published.device, {}
    for wall in published.walls:
        squares = [
            felt_square(device, wall.k, wall.b, period, coupling=published.tuned),
            rendered_square(wall.k, wall.b, period),
        ]
        edges, middles = cells(squares, *span, period)
        rendered = np.abs(environment_impedance(middles, wall.environment, period))
        felt = published.felt(middles, wall.environment, coupling=published.tuned)
        shares[wall.name] = share(edges, felt < rendered)
    worst = min(shares, key=shares.__getitem__)
    environment = next(wall.environment for wall in published.walls if wall.name == worst)
    return {
        "cases": [case for part in shares.values() for case in (part > 0, part == 1.0)],
        "always": [name for name, part in shares.items() if part == 1.0],
        "shares": shares, "worst": worst, "least": shares[worst],
        "others": {name: part for name, part in shares.items() if name != worst},
        "with_it": float(published.felt(LOOKED_AT, environment, coupling=published.tuned)),
        "alone": float(np.abs(environment_impedance(LOOKED_AT, environment, period))),
    }  # fmt: skip


def lower_or_medium(published: Published) -> Evidence:
    """Judge whether the coupling takes low and medium impedances out of the boundaries."""
    order = sorted(published.walls, key=lambda wall: wall.k)
    lower = order[:-2]
    coupled, direct = {}, {}
    for wall in lower:
        coupled[wall.name] = share_true(published, wall, coupled_inside)
        direct[wall.name] = share_true(published, wall, direct_inside)
    spoilt, _ = _spoilt(published)
    outside = [name for name, part in coupled.items() if part < 1]
    return {
        "cases": [wall.name in names for names in (outside, spoilt) for wall in lower],
        "lost": list(dict.fromkeys(spoilt)),
        "coupled": coupled,
        "direct": direct,
        "least": min(coupled.values()),
    }


def affects_realism(published: Published) -> Evidence:
    """Judge the conclusion that a static coupling can spoil realism, by the next user's boundary."""
    spoilt, tried = _spoilt(published)
    names = list(dict.fromkeys(spoilt))
    return {"cases": [bool(spoilt)], "names": names, "spoilt": len(spoilt), "tried": tried}


def _spoilt(published: Published) -> tuple[list[str], int]:
    """Return the environments that only the coupling takes out, once a device, and how many were tried."""
    devices = [Device(mass, published.device.damping) for mass in (0.0, *MASSES[::14])]
    spoilt = [
        wall.name
        for wall, box in zip(published.walls, published.next_user, strict=True)
        for device in devices
        if _inside(published, wall, device, box, None)
        and not _inside(published, wall, device, box, published.tuned)
    ]
    return spoilt, len(published.walls) * len(devices)


def _inside(
    published: Published, wall: Wall, device: Device, box: Array, coupling: Coupling | None
) -> bool:
    """Say whether a reference stays inside the envelope of a box of k and b at every perceivable ω."""
    span, period = published.span, published.period
    felt = felt_square(device, wall.k, wall.b, period, coupling=coupling)
    cuts = [cells([felt, each], *span, period)[0] for each in envelope_squares(device, box, period)]
    edges = np.unique(np.concatenate(cuts))
    middles = np.sqrt(edges[1:] * edges[:-1])
    lower, upper = magnitude_envelope(middles, device, box[0], box[1], period)
    seen = published.felt(middles, wall.environment, coupling=coupling, device=device)
    return bool(((lower <= seen) & (seen <= upper)).all())
