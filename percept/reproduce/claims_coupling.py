"""Claims on the coupling: what it asks of the device, and what it does to realism."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from percept.haptics import (
    Coupling,
    Device,
    absolute_stability,
    environment_impedance,
    magnitude_envelope,
    required_damping,
)
from percept.haptics.limits import best_coupling_damping, passivity_damping
from percept.reproduce.devices import DAMPINGS, MASSES
from percept.reproduce.published import LOOKED_AT, THEORETICAL, Array, Evidence, Published, Wall
from percept.reproduce.squares import cells, envelope_squares, felt_square, rendered_square, share

_SAME = 1e-9


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
    return {
        "cases": [own > needed for needed in colgate.values()],
        "largest": max(colgate.values()), "largest_paper": max(paper.values()),
        "fine": [name for name, needed in colgate.items() if own > needed],
        "each": colgate, "colgate": list(colgate.values()), "paper": list(paper.values()),
    }  # fmt: skip


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


def affects_realism(published: Published) -> Evidence:
    """Judge the conclusion that a static coupling can spoil realism, by the next user's boundary."""
    devices = [Device(mass, published.device.damping) for mass in (0.0, *MASSES[::14])]
    spoilt = [
        wall.name
        for wall, box in zip(published.walls, published.next_user, strict=True)
        for device in devices
        if _inside(published, wall, device, box, None)
        and not _inside(published, wall, device, box, published.tuned)
    ]
    tried = len(published.walls) * len(devices)
    names = list(dict.fromkeys(spoilt))
    return {"cases": [bool(spoilt)], "names": names, "spoilt": len(spoilt), "tried": tried}


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
