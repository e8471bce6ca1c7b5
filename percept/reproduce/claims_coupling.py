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
from percept.reproduce.published import (
    LOOKED_AT,
    THEORETICAL,
    Array,
    Judgement,
    Published,
    Quantity,
    Wall,
    judged,
    listed,
    unjudged,
)
from percept.reproduce.squares import cells, envelope_squares, felt_square, rendered_square, share

_SAME = 1e-9


def poles_unseen(published: Published) -> Judgement:
    """Judge whether Eqs 9 and 10 suffice without a look at the poles."""
    k, b = float(published.tuned.stiffness), float(published.tuned.damping)
    stretch = k * published.period
    # Eq. 10 sees k_c squared and the damping b_c + k_cT/2, which these two share; 1/Z_c has this pole.
    mirrored = b + stretch
    own, other = (b / mirrored, mirrored / b) if stretch else (0.0, 0.0)
    return judged(
        cases=[own <= 1, other <= 1],
        condition="no pole lies outside the unit circle; with m ≥ 0 and k_c ≥ 0 in Eqs 5 and 6 none does",
        finding="The conditions are necessary. They look at real parts on the unit circle, and Llewellyn’s "
        f"criterion also looks at poles. A coupling of −{k / 1e3:g} kN/m and {mirrored:g} N·s/m meets both "
        f"equations exactly where {k / 1e3:g} kN/m and {b:g} N·s/m do. Its 1/Z_c has a pole at z = "
        f"{other:.3g}; the paper’s coupling has its pole at {own:.3g}.",
        margin=Quantity("pole of 1/Z_c with k_c negative", other),
        numbers=[Quantity("pole of 1/Z_c, tuned coupling", own)],
    )


def one_coupling(published: Published) -> Judgement:
    """Judge whether Eqs 6 and 12 are about one coupling."""
    k, b, period = float(THEORETICAL.stiffness), float(THEORETICAL.damping), published.period
    backward = published.needed()
    converted = Coupling(k, b + k * period / 2)
    tustin, again = (
        float(required_damping(coupling, period, discretization="tustin").damping)
        for coupling in (THEORETICAL, converted)
    )
    return judged(
        cases=[abs(tustin - backward) <= _SAME * backward, abs(again - backward) <= _SAME * backward],
        condition=f"b_c of Eq. 12 is raised by k_cT/2, here from {b:g} to {converted.damping:g} N·s/m",
        finding="Eq. 6 takes the backward difference for s, and Eq. 12 Tustin’s. With the same k_c and b_c "
        f"Eq. 6 asks the device for {backward:.6g} N·s/m, and Eq. 12’s form for {tustin:.6g}.",
        margin=Quantity("Tustin over backward difference, damping asked for", tustin / backward),
        numbers=[
            Quantity("damping asked for, Eq. 6", backward, "N·s/m"),
            Quantity("damping asked for, Eq. 12's form", tustin, "N·s/m"),
        ],
    )


def fig_4_theoretical(published: Published) -> Judgement:
    """Judge Fig. 4's theoretical coupling."""
    return _stable_with(published, THEORETICAL)


def fig_4_tuned(published: Published) -> Judgement:
    """Judge the coupling found by tuning."""
    return _stable_with(published, published.tuned)


def _stable_with(published: Published, coupling: Coupling) -> Judgement:
    record = required_damping(coupling, published.period)
    needed = float(record.damping)
    best, least = best_coupling_damping(float(coupling.stiffness), published.period)
    own = float(published.device.damping)
    return judged(
        cases=needed <= DAMPINGS,
        condition=f"the device has at least {needed:.6g} N·s/m (rigid; its damping was never published)",
        finding=f"Eq. 10 asks most of a rigid device at {float(record.omega):.6g} rad/s. With b_c = "
        f"{best:.4g} N·s/m the same stiffness would need {least:.4g} N·s/m only. "
        f"The scene’s device has {own:g}.",
        margin=Quantity("damping asked for", needed, "N·s/m"),
        numbers=[
            Quantity("ω that binds", float(record.omega), "rad/s"),
            Quantity("least damping asked for with this k_c", least, "N·s/m"),
        ],
    )


def worst_case(published: Published) -> Judgement:
    """Say why nobody can judge that a worst-case design made the system unstable."""
    short = absolute_stability(published.device, THEORETICAL, published.period)
    return unjudged(
        needs="the device’s Z_d as measured up to Nyquist, its friction, and the hand and environment of "
        "the unstable run",
        finding="In the paper’s model a coupling that meets Eqs 9 and 10 is stable with every passive hand "
        "and environment. The worst case is the safe side. The device may have too little damping for Eq. "
        f"10, or the model may lack what mattered. The scene’s device has {short.smallest_margin:.1%} of the "
        f"damping asked for at {short.binding_omega:.5g} rad/s.",
        numbers=[Quantity("damping of the scene’s device over that asked for", short.smallest_margin, "1")],
    )


def direct_rendering(published: Published) -> Judgement:
    """Judge stable interaction with the reference without a coupling."""
    own = float(published.device.damping)
    environments = [wall.environment for wall in published.walls]
    colgate, paper = (
        np.array([float(passivity_damping(one, published.period, model=model)) for one in environments])
        for model in ("colgate", "tustin")
    )
    fine = [wall.name for wall, needed in zip(published.walls, colgate, strict=True) if own > needed]
    return judged(
        cases=own > colgate,
        condition=f"b_d is above {colgate.max():g} N·s/m; with {own:g} N·s/m it is true of {listed(fine)}",
        finding="Stable with every passive hand means b_d > kT/2 + |b| (true hold, backward difference): "
        f"{', '.join(f'{x:.4g}' for x in colgate)} N·s/m. The paper’s own Eqs 7 and 8 ask for b_d ≥ kT/2 − "
        f"b: {', '.join(f'{x:.4g}' for x in paper)} N·s/m. Where this fails a wall may chatter, which would "
        "bias what is set.",
        margin=Quantity("damping asked for, largest", float(colgate.max()), "N·s/m"),
        numbers=[
            *(
                Quantity(f"damping asked for, {wall.name}", float(x), "N·s/m")
                for wall, x in zip(published.walls, colgate, strict=True)
            ),
            Quantity("damping asked for, largest, Eqs 7 and 8", float(paper.max()), "N·s/m"),
        ],
    )


def suits_high(published: Published) -> Judgement:
    """Judge whether a coupling suits high impedance and harms low."""
    stiffness = {wall.name: published.through_coupling(wall)[0] for wall in published.walls}
    order = sorted(published.walls, key=lambda wall: wall.k)
    loss = {wall.name: float(1 - stiffness[wall.name] / wall.k) for wall in order}
    inside = [w.name for w in order if w.stiffness[0] <= stiffness[w.name] <= w.stiffness[1]]
    high = [wall.name for wall in order[-2:]]
    told = ", ".join(f"{part:.2%} ({name})" for name, part in loss.items())
    falls = [soft >= stiff for soft, stiff in pairwise(loss.values())]
    return judged(
        cases=[*(name in inside for name in high), *falls],
        condition=f"one looks at {listed([name for name in high if name in inside])} alone",
        finding=f"The stiffness lost does not rise with the wall’s: {told}."
        if any(falls)
        else f"The opposite is true: the coupling takes {told} of the stiffness, more the stiffer the wall. "
        f"Inside its limits stays {listed(inside)}. The paper itself finds VE4 unrealistic on Fig. 7f.",
        margin=Quantity("stiffness lost at the stiffest wall", loss[order[-1].name], "1"),
        numbers=[Quantity(f"effective stiffness, {name}", float(k), "N/m") for name, k in stiffness.items()],
    )


def always_smaller(published: Published) -> Judgement:
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
    with_it = float(published.felt(LOOKED_AT, environment, coupling=published.tuned))
    alone = float(np.abs(environment_impedance(LOOKED_AT, environment, period)))
    always = [name for name, part in shares.items() if part == 1.0]
    told = ", ".join(f"{part:.1%} ({name})" for name, part in shares.items())
    return judged(
        cases=[case for part in shares.values() for case in (part > 0, part == 1.0)],
        condition="the coupling takes more than the device adds; with the scene’s device always at "
        f"{listed(always)}",
        finding=f"The hand feels the device too. With m = {device.mass:g} kg and b_d = {device.damping:g} "
        f"N·s/m |Z_h_vc| is below |Z_e| over {told} of the range. At {LOOKED_AT:g} rad/s {worst} has "
        f"{with_it:.5g} N·s/m against {alone:.5g}. Without a device it is always smaller.",
        margin=Quantity(f"share of the range, {worst}", shares[worst], "1"),
        numbers=[
            Quantity(f"|Z_h_vc| of {worst}", with_it, "N·s/m"),
            Quantity(f"|Z_e| of {worst}", alone, "N·s/m"),
            *(
                Quantity(f"share of the range, {name}", part, "1")
                for name, part in shares.items()
                if name != worst
            ),
        ],
    )


def affects_realism(published: Published) -> Judgement:
    """Judge the conclusion that a static coupling can spoil realism, by the next user's boundary."""
    masses = (0.0, *MASSES[::14])
    spoilt = [
        wall.name
        for wall, box in zip(published.walls, published.next_user, strict=True)
        for device in (Device(mass, published.device.damping) for mass in masses)
        if _inside(published, wall, device, box, None)
        and not _inside(published, wall, device, box, published.tuned)
    ]
    names = list(dict.fromkeys(spoilt))
    return judged(
        cases=[bool(names)],
        finding="Judge by the next user’s boundary over the whole perceivable range. Inside when displayed "
        f"directly, and outside through the coupling: {listed(names)}, in {len(spoilt)} of "
        f"{len(published.walls) * len(masses)} environments and masses tried.",
        margin=Quantity("environments and masses spoilt by the coupling", len(spoilt)),
    )


def _inside(published: Published, wall: Wall, device: Device, box: Array, coupling: Coupling | None) -> bool:
    """Say whether a reference stays inside the envelope of a box of k and b at every perceivable ω."""
    span, period = published.span, published.period
    felt = felt_square(device, wall.k, wall.b, period, coupling=coupling)
    cuts = [cells([felt, each], *span, period)[0] for each in envelope_squares(device, box, period)]
    edges = np.unique(np.concatenate(cuts))
    middles = np.sqrt(edges[1:] * edges[:-1])
    lower, upper = magnitude_envelope(middles, device, box[0], box[1], period)
    seen = published.felt(middles, wall.environment, coupling=coupling, device=device)
    return bool(((lower <= seen) & (seen <= upper)).all())
