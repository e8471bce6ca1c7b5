"""Claims on section 2: what the coupling asks of the device."""

from __future__ import annotations

import numpy as np

from percept.haptics import (
    Coupling,
    Device,
    absolute_stability,
    best_coupling_damping,
    passivity_damping,
    required_damping,
)
from percept.reproduce.claims.record import Claim, Quantity, listed
from percept.reproduce.devices import DAMPINGS, MASSES
from percept.reproduce.published import THEORETICAL, Published

_SAME = 1e-9


def one_coupling(published: Published) -> Claim:
    """Judge whether Eqs 6 and 12 are about one coupling."""
    k, b, period = float(THEORETICAL.stiffness), float(THEORETICAL.damping), published.period
    backward = float(required_damping(THEORETICAL, period).damping)
    tustin = float(required_damping(THEORETICAL, period, discretization="tustin").damping)
    converted = Coupling(k, b + k * period / 2)
    again = float(required_damping(converted, period, discretization="tustin").damping)
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
    return _stable_with(
        published,
        THEORETICAL,
        "fig-4-theoretical",
        "Section 2.3, Fig. 4",
        "meets Eq. 10 with the device",
    )


def tuned_coupling(published: Published) -> Claim:
    """Judge the coupling found by tuning."""
    return _stable_with(
        published, published.tuned, "fig-4-tuned", "Section 2.3, Fig. 4", "is suitable after fine tuning"
    )


def _stable_with(published: Published, coupling: Coupling, name: str, place: str, says: str) -> Claim:
    record = required_damping(coupling, published.period)
    needed = float(record.damping)
    best = best_coupling_damping(coupling.stiffness, published.period)
    own = float(published.device.damping)
    return Claim.judged(
        name,
        place=place,
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
    needed = float(required_damping(THEORETICAL, published.period).damping)
    enough = needed * (1 + 1e-6)
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
    colgate, paper = (
        np.array(
            [float(passivity_damping(w.environment, published.period, model=model)) for w in published.walls]
        )
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
