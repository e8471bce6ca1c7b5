"""Claims on what a coupling does to realism."""

from __future__ import annotations

import numpy as np

from percept.haptics import (
    Device,
    effective_impedance,
    environment_impedance,
    magnitude_envelope,
    perceived_impedance,
)
from percept.reproduce.claims.record import Claim, Quantity, listed
from percept.reproduce.devices import MASSES
from percept.reproduce.published import LOOKED_AT, Published


def other_environments(published: Published) -> Claim:
    """Judge whether the environments drawn stand for those that are not."""
    drawn = {wall.name for wall, _ in published.drawn}
    stiffness = _effective(published)
    others = [(wall, k) for wall, k in zip(published.walls, stiffness, strict=True) if wall.name not in drawn]
    below = [wall.stiffness[0] > k for wall, k in others]
    lost = [wall.name for (wall, _), out in zip(others, below, strict=True) if out]
    worst = min((k / wall.stiffness[0] for wall, k in others), default=1.0)
    return Claim.judged(
        "other-environments",
        place="Section 4",
        paper="Three environments stand for all five: only the stiffest drawn is pushed out of its limits.",
        cases=[not out for out in below],
        condition=f"{listed(lost)} are left out",
        finding="Through the coupling "
        + "; ".join(
            f"{wall.name} feels like {k:.5g} N/m (limits {wall.stiffness[0]:g} to {wall.stiffness[1]:g})"
            for wall, k in zip(published.walls, stiffness, strict=True)
        )
        + f". Of those not drawn, {sum(below)} of {len(below)} fall below their limits.",
        margin=Quantity("effective stiffness over lower limit, least of those not drawn", worst),
        numbers=[
            Quantity(f"effective stiffness, {wall.name}", float(k), "N/m")
            for wall, k in zip(published.walls, stiffness, strict=True)
        ],
        source="percept.haptics.effective_impedance(10, environment, coupling, period).stiffness",
    )


def suits_high(published: Published) -> Claim:
    """Judge whether a coupling suits high impedance and harms low."""
    stiffness = _effective(published)
    loss = 1 - stiffness / np.array([wall.k for wall in published.walls])
    order = np.argsort([wall.k for wall in published.walls])
    inside = np.array(
        [
            wall.stiffness[0] <= k <= wall.stiffness[1]
            for wall, k in zip(published.walls, stiffness, strict=True)
        ]
    )
    high = order[-2:]
    return Claim.judged(
        "suits-high",
        place="Section 5",
        paper="A static coupling suits high impedance only; at low or medium impedance realism suffers.",
        cases=[*inside[high], *(loss[order[:-1]] >= loss[order[1:]])],
        condition=f"one looks at {listed([published.walls[i].name for i in high if inside[i]])} alone",
        finding="The opposite: the coupling takes "
        + ", ".join(f"{loss[i]:.2%} ({published.walls[i].name})" for i in order)
        + f" of the stiffness, more the stiffer the wall; inside its limits stays "
        f"{listed([published.walls[i].name for i in order if inside[i]])}."
        if (loss[order[:-1]] < loss[order[1:]]).all()
        else "The stiffness lost does not rise with the wall’s: "
        + ", ".join(f"{loss[i]:.2%} ({published.walls[i].name})" for i in order)
        + ".",
        margin=Quantity("stiffness lost at the stiffest wall", float(loss[order[-1]]), "1"),
        numbers=[Quantity("stiffness lost at the softest wall", float(loss[order[0]]), "1")],
        source="percept.haptics.effective_impedance(10, environment, coupling, period).stiffness",
    )


def always_smaller(published: Published) -> Claim:
    """Judge whether a coupling always lowers what is felt."""
    omega, device, period = published.omega(), published.device, published.period
    lower, passive = [], []
    for wall in published.walls:
        direct = np.abs(perceived_impedance(omega, device, wall.environment, period))
        coupled = np.abs(
            perceived_impedance(omega, device, wall.environment, period, coupling=published.tuned)
        )
        lower.append(coupled < direct)
        shown = effective_impedance(omega, wall.environment, published.tuned, period).value
        passive.append(np.abs(shown) < np.abs(environment_impedance(omega, wall.environment, period)))
    found, alone = np.array(lower), np.array(passive)
    wall = published.walls[int(np.argmin(found.mean(axis=1)))]
    without, through = (
        float(np.abs(perceived_impedance(LOOKED_AT, device, wall.environment, period, coupling=coupling)))
        for coupling in (None, published.tuned)
    )
    return Claim.judged(
        "always-smaller",
        place="Section 5",
        paper="With a coupling the perceived impedance is always smaller than without.",
        cases=found.ravel(),
        condition="the stiffness still outweighs the device’s mass",
        finding=f"With m = {device.mass:g} kg and b_d = {device.damping:g} N·s/m it is smaller in "
        f"{found.mean():.1%} of environments and frequencies. Where the mass dominates it is larger: "
        f"{wall.name} at {LOOKED_AT:g} rad/s has {through:.6g} N·s/m with and {without:.6g} without. "
        f"Environment and coupling alone, |Z_eff| < |Z_e|, is true in {alone.mean():.1%}.",
        margin=Quantity("share of cases in which it is smaller", float(found.mean()), "1"),
        numbers=[
            Quantity(f"|Z_h_vc| of {wall.name}", through, "N·s/m"),
            Quantity(f"|Z_h| of {wall.name}", without, "N·s/m"),
            Quantity("share of cases with |Z_eff| < |Z_e|", float(alone.mean()), "1"),
        ],
        source="percept.haptics.perceived_impedance with and without coupling",
    )


def affects_realism(published: Published) -> Claim:
    """Judge the conclusion that a static coupling can spoil realism, by the next user's boundary."""
    omega, period = published.omega(61), published.period
    spoilt = []
    for wall, (k, b) in zip(published.walls, published.next_user, strict=True):
        for mass in (0.0, *MASSES[::14]):
            device = Device(mass, published.device.damping)
            lower, upper = magnitude_envelope(omega, device, k, b, period)
            direct, coupled = (
                np.abs(perceived_impedance(omega, device, wall.environment, period, coupling=coupling))
                for coupling in (None, published.tuned)
            )
            held = ((lower <= direct) & (direct <= upper)).all()
            lost = ((coupled < lower) | (upper < coupled)).any()
            if held and lost:
                spoilt.append(wall.name)
    names = list(dict.fromkeys(spoilt))
    return Claim.judged(
        "affects-realism",
        place="Section 6",
        paper="A static coupling can take a haptic system out of what feels real.",
        cases=[bool(names)],
        finding=f"Judged by the next user’s boundary over the whole perceivable range, the reference of "
        f"{listed(names)} is inside when displayed directly and leaves it through the coupling "
        f"({len(spoilt)} of {len(published.walls) * (1 + len(MASSES[::14]))} environments and masses tried).",
        margin=Quantity("environments and masses spoilt by the coupling", len(spoilt)),
        source="percept.haptics.magnitude_envelope over percept.inference.prediction_interval",
    )


def _effective(published: Published) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the stiffness each reference shows through the tuned coupling, N/m."""
    return np.array([float(published.through_coupling(wall).stiffness) for wall in published.walls])
