"""Claims on the coupling: what it asks of the device, and what it does to realism."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from percept.haptics import (
    Coupling,
    Device,
    absolute_stability,
    best_coupling_damping,
    effective_impedance,
    environment_impedance,
    magnitude_envelope,
    passivity_damping,
    required_damping,
)
from percept.reproduce.devices import DAMPINGS, MASSES
from percept.reproduce.published import LOOKED_AT, THEORETICAL, Array, Claim, Published, Quantity, listed

_SAME = 1e-9


def one_coupling(published: Published) -> Claim:
    """Judge whether Eqs 6 and 12 are about one coupling."""
    k, b, period = float(THEORETICAL.stiffness), float(THEORETICAL.damping), published.period
    backward = published.needed()
    converted = Coupling(k, b + k * period / 2)
    tustin, again = (
        float(required_damping(coupling, period, discretization="tustin").damping)
        for coupling in (THEORETICAL, converted)
    )
    return Claim.judged(
        "one-coupling",
        place="Eqs 6, 12",
        paper="Eq. 6 (stability) and Eq. 12 (transparency) describe the same coupling.",
        cases=[abs(tustin - backward) <= _SAME * backward, abs(again - backward) <= _SAME * backward],
        condition=f"b_c of Eq. 12 is raised by k_cT/2, here from {b:g} to {converted.damping:g} N·s/m",
        finding=f"With the same k_c and b_c, Eq. 6 (backward difference) asks the device for {backward:.6g} "
        f"N·s/m and Eq. 12’s form (Tustin) for {tustin:.6g}. They agree once b_c is raised by k_cT/2.",
        margin=Quantity("Tustin over backward difference, damping asked for", tustin / backward),
        numbers=[
            Quantity("damping asked for, Eq. 6", backward, "N·s/m"),
            Quantity("damping asked for, Eq. 12's form", tustin, "N·s/m"),
        ],
        source="percept.haptics.required_damping(..., discretization=)",
    )


def theoretical_coupling(published: Published) -> Claim:
    """Judge Fig. 4's theoretical coupling."""
    return _stable_with(published, THEORETICAL, "fig-4-theoretical", "meets Eq. 10 with the device")


def tuned_coupling(published: Published) -> Claim:
    """Judge the coupling found by tuning."""
    return _stable_with(published, published.tuned, "fig-4-tuned", "is suitable after fine tuning")


def _stable_with(published: Published, coupling: Coupling, name: str, says: str) -> Claim:
    record = required_damping(coupling, published.period)
    needed = float(record.damping)
    best = best_coupling_damping(coupling.stiffness, published.period)
    own = float(published.device.damping)
    return Claim.judged(
        name,
        place="Section 2.3, Fig. 4",
        paper=f"The coupling of {float(coupling.stiffness) / 1e3:g} kN/m and {coupling.damping:g} N·s/m "
        f"{says}.",
        cases=needed <= DAMPINGS,
        condition=f"the device has at least {needed:.6g} N·s/m (rigid; its damping was never published)",
        finding=f"Eq. 10 asks a rigid device for {needed:.6g} N·s/m, most at {float(record.omega):.6g} "
        f"rad/s. With b_c = {float(best.coupling_damping):.4g} N·s/m the same stiffness would ask for "
        f"{float(best.device_damping):.4g} N·s/m only. The scene’s device has {own:g}.",
        margin=Quantity("damping asked for", needed, "N·s/m"),
        numbers=[
            Quantity("ω that binds", float(record.omega), "rad/s"),
            Quantity("least damping asked for with this k_c", float(best.device_damping), "N·s/m"),
        ],
        source=f"percept.haptics.required_damping(Coupling({float(coupling.stiffness):g}, "
        f"{float(coupling.damping):g}), {published.period:g})",
    )


def worst_case(published: Published) -> Claim:
    """Judge the explanation that a worst-case design made the system unstable."""
    enough = published.needed() * (1 + 1e-6)
    verdicts = [
        absolute_stability(Device(mass, enough), THEORETICAL, published.period).verdict
        for mass in MASSES[::10]
    ]
    short = absolute_stability(published.device, THEORETICAL, published.period)
    return Claim.judged(
        "worst-case",
        place="Section 2.3",
        paper="A coupling designed for the worst case makes the system easily unstable.",
        cases=[verdict == "unstable" for verdict in verdicts],
        condition="the device’s mass is one of those with which it is unstable",
        finding=f"Absolute stability is the conservative side: of {len(verdicts)} masses tried with the "
        f"damping Eq. 10 asks for, {verdicts.count('unstable')} are unstable with some passive hand and "
        "environment. Instability means that the device falls short of it: the scene’s has "
        f"{short.smallest_margin:.3g} times what is asked for at {short.binding_omega:.5g} rad/s.",
        margin=Quantity("unstable cases at the limit", verdicts.count("unstable")),
        numbers=[Quantity("margin of the scene's device", short.smallest_margin)],
        source="percept.haptics.absolute_stability(device, coupling, period)",
    )


def direct_rendering(published: Published) -> Claim:
    """Judge stable interaction with the reference without a coupling."""
    own = float(published.device.damping)
    environments = [wall.environment for wall in published.walls]
    colgate, paper = (
        np.array([float(passivity_damping(one, published.period, model=model)) for one in environments])
        for model in ("colgate", "tustin")
    )
    fine = [wall.name for wall, needed in zip(published.walls, colgate, strict=True) if own > needed]
    return Claim.judged(
        "direct-rendering",
        place="Sections 3.1 and 3.2",
        paper="The references are displayed stably without a coupling.",
        cases=own > colgate,
        condition=f"b_d is above {colgate.max():g} N·s/m; with {own:g} N·s/m it is true of {listed(fine)}",
        finding=f"Passive by themselves they need b_d > kT/2 + |b|: {', '.join(f'{x:.4g}' for x in colgate)} "
        "N·s/m (true hold, backward difference); the paper’s own Eqs 7 and 8 ask for kT/2 − b: "
        f"{', '.join(f'{x:.4g}' for x in paper)} N·s/m. Where this fails a wall may chatter, which would "
        "bias what is set.",
        margin=Quantity("damping asked for, largest", float(colgate.max()), "N·s/m"),
        numbers=[
            *(
                Quantity(f"damping asked for, {wall.name}", float(x), "N·s/m")
                for wall, x in zip(published.walls, colgate, strict=True)
            ),
            Quantity("damping asked for, largest, Eqs 7 and 8", float(paper.max()), "N·s/m"),
        ],
        source="percept.haptics.passivity_damping(environment, period, model=)",
    )


def other_environments(published: Published) -> Claim:
    """Judge whether the environments drawn stand for those that are not."""
    drawn = {wall.name for wall, _ in published.drawn}
    stiffness = list(zip(published.walls, _effective(published), strict=True))
    others = [(wall, k) for wall, k in stiffness if wall.name not in drawn]
    lost = [wall.name for wall, k in others if wall.stiffness[0] > k]
    told = "; ".join(
        f"{wall.name} feels like {k:.5g} N/m (limits {wall.stiffness[0]:g} to {wall.stiffness[1]:g})"
        for wall, k in stiffness
    )
    return Claim.judged(
        "other-environments",
        place="Section 4",
        paper="Three environments stand for all five: only the stiffest drawn is pushed out of its limits.",
        cases=[wall.name not in lost for wall, _ in others],
        condition=f"{listed(lost)} are left out",
        finding=f"Through the coupling {told}. Of those not drawn, {len(lost)} of {len(others)} fall below "
        "their limits.",
        margin=Quantity(
            "effective stiffness over lower limit, least of those not drawn",
            min((k / wall.stiffness[0] for wall, k in others), default=1.0),
        ),
        numbers=[Quantity(f"effective stiffness, {wall.name}", float(k), "N/m") for wall, k in stiffness],
        source="percept.haptics.effective_impedance(10, environment, coupling, period).stiffness",
    )


def suits_high(published: Published) -> Claim:
    """Judge whether a coupling suits high impedance and harms low."""
    stiffness = dict(zip((wall.name for wall in published.walls), _effective(published), strict=True))
    order = sorted(published.walls, key=lambda wall: wall.k)
    loss = {wall.name: float(1 - stiffness[wall.name] / wall.k) for wall in order}
    inside = [w.name for w in order if w.stiffness[0] <= stiffness[w.name] <= w.stiffness[1]]
    high = [wall.name for wall in order[-2:]]
    told = ", ".join(f"{share:.2%} ({name})" for name, share in loss.items())
    falls = [soft >= stiff for soft, stiff in pairwise(loss.values())]
    return Claim.judged(
        "suits-high",
        place="Section 5",
        paper="A static coupling suits high impedance only; at low or medium impedance realism suffers.",
        cases=[*(name in inside for name in high), *falls],
        condition=f"one looks at {listed([name for name in high if name in inside])} alone",
        finding=f"The stiffness lost does not rise with the wall’s: {told}."
        if any(falls)
        else f"The opposite: the coupling takes {told} of the stiffness, more the stiffer the wall; inside "
        f"its limits stays {listed(inside)}.",
        margin=Quantity("stiffness lost at the stiffest wall", loss[order[-1].name], "1"),
        numbers=[Quantity("stiffness lost at the softest wall", loss[order[0].name], "1")],
        source="percept.haptics.effective_impedance(10, environment, coupling, period).stiffness",
    )


def always_smaller(published: Published) -> Claim:
    """Judge whether a coupling always lowers what is felt."""
    omega, device, period = published.omega(), published.device, published.period
    felt, alone = [], []
    for wall in published.walls:
        direct, coupled = (
            published.felt(omega, wall.environment, coupling=coupling) for coupling in (None, published.tuned)
        )
        felt.append(coupled < direct)
        through = effective_impedance(omega, wall.environment, published.tuned, period).value
        alone.append(np.abs(through) < np.abs(environment_impedance(omega, wall.environment, period)))
    wall = published.walls[int(np.argmin(np.mean(felt, axis=1)))]
    without, with_it = (
        float(published.felt(LOOKED_AT, wall.environment, coupling=coupling))
        for coupling in (None, published.tuned)
    )
    return Claim.judged(
        "always-smaller",
        place="Section 5",
        paper="With a coupling the perceived impedance is always smaller than without.",
        cases=np.ravel(felt),
        condition="the stiffness still outweighs the device’s mass",
        finding=f"With m = {device.mass:g} kg and b_d = {device.damping:g} N·s/m it is smaller in "
        f"{np.mean(felt):.1%} of environments and frequencies. Where the mass dominates it is larger: "
        f"{wall.name} at {LOOKED_AT:g} rad/s has {with_it:.6g} N·s/m with and {without:.6g} without. "
        f"Environment and coupling alone, |Z_eff| < |Z_e|, is true in {np.mean(alone):.1%}.",
        margin=Quantity("share of cases in which it is smaller", float(np.mean(felt)), "1"),
        numbers=[
            Quantity(f"|Z_h_vc| of {wall.name}", with_it, "N·s/m"),
            Quantity(f"|Z_h| of {wall.name}", without, "N·s/m"),
            Quantity("share of cases with |Z_eff| < |Z_e|", float(np.mean(alone)), "1"),
        ],
        source="percept.haptics.perceived_impedance with and without coupling",
    )


def affects_realism(published: Published) -> Claim:
    """Judge the conclusion that a static coupling can spoil realism, by the next user's boundary."""
    omega, masses = published.omega(61), (0.0, *MASSES[::14])
    spoilt = []
    for wall, (k, b) in zip(published.walls, published.next_user, strict=True):
        for mass in masses:
            device = Device(mass, published.device.damping)
            lower, upper = magnitude_envelope(omega, device, k, b, published.period)
            direct, coupled = (
                published.felt(omega, wall.environment, coupling=coupling, device=device)
                for coupling in (None, published.tuned)
            )
            held = ((lower <= direct) & (direct <= upper)).all()
            if held and ((coupled < lower) | (upper < coupled)).any():
                spoilt.append(wall.name)
    names = list(dict.fromkeys(spoilt))
    return Claim.judged(
        "affects-realism",
        place="Section 6",
        paper="A static coupling can take a haptic system out of what feels real.",
        cases=[bool(names)],
        finding=f"Judged by the next user’s boundary over the whole perceivable range, the reference of "
        f"{listed(names)} is inside when displayed directly and leaves it through the coupling "
        f"({len(spoilt)} of {len(published.walls) * len(masses)} environments and masses tried).",
        margin=Quantity("environments and masses spoilt by the coupling", len(spoilt)),
        source="percept.haptics.magnitude_envelope over percept.inference.prediction_interval",
    )


def _effective(published: Published) -> Array:
    """Return the stiffness each reference shows through the tuned coupling, N/m."""
    return np.array([float(published.through_coupling(wall).stiffness) for wall in published.walls])
