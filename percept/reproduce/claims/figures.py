"""Claims on Figs 4 and 7: which devices they can have been drawn for."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from percept.haptics import Device, required_damping
from percept.reproduce.claims.record import Claim, Quantity, listed
from percept.reproduce.devices import DAMPINGS, MASSES, Panel, curves, largest, over_devices, panels
from percept.reproduce.published import LOOKED_AT, THEORETICAL, Published

_AND_NONE = np.concatenate([[0.0], MASSES])


def free_motion(published: Published) -> Claim:
    """Judge Fig. 7b: nearly free motion is displayed below both boundaries."""
    panel = panels(published)[0]
    mass, damping = _extent(published, panel)
    device = published.device
    found = curves(np.array([LOOKED_AT]), device, panel.wall, published.tuned, published.period)
    k_low, k_high = panel.wall.stiffness
    return Claim.judged(
        "fig-7b",
        place="Fig. 7b, section 5",
        paper="In nearly free motion |Z_h| and |Z_h_vc| lie below both boundaries.",
        cases=_everywhere(published, panel),
        condition=_light(mass, damping),
        finding=f"The statement needs a light device: {_light(mass, damping)}. With the scene's device (m = "
        f"{device.mass:g} kg, b_d = {device.damping:g} N·s/m) |Z_h| is {found.direct[0]:.5g} N·s/m between "
        f"boundaries of {found.lower[0]:.5g} and {found.upper[0]:.5g} N·s/m at {LOOKED_AT:g} rad/s. What is "
        f"called a lower limit of perception is a bias: the limits of k, {k_low:g} to {k_high:g} N/m, leave "
        f"out {panel.wall.k:g} N/m.",
        margin=Quantity("largest mass", mass, "kg"),
        numbers=[
            Quantity("largest device damping", damping, "N·s/m"),
            Quantity("ω from", panel.window[0], "rad/s"),
            Quantity("ω to", panel.window[1], "rad/s"),
        ],
        source="percept.reproduce.devices.over_devices; percept.haptics.corner_curves",
    )


def one_device(published: Published) -> Claim:
    """Judge whether one rigid device can show both Fig. 4 and Fig. 7b."""
    panel = panels(published)[0]
    _, damping = _extent(published, panel)
    needed = float(required_damping(THEORETICAL, published.period).damping)
    both = over_devices(published, panel, MASSES, np.array(needed))
    heaviest = largest(partial(over_devices, published, panel, damping=np.array(needed)), MASSES)
    return Claim.judged(
        "one-device",
        place="Figs 4 and 7b",
        paper="One device is behind Fig. 4 and Fig. 7b.",
        cases=both,
        condition=f"its mass stays below {_limit(heaviest)} kg",
        finding=f"With {THEORETICAL.stiffness / 1e3:g} kN/m on its limit, as Fig. 4 has it, a rigid device "
        f"has at least {needed:.5g} N·s/m; Fig. 7b asks for at most {damping:.4g} N·s/m, whatever the mass. "
        f"{int(both.sum())} of {both.size} masses tried do both. No rigid device should be calibrated to "
        "both.",
        margin=Quantity("damping Fig. 4 needs over what Fig. 7b allows", needed / damping),
        numbers=[
            Quantity("damping Fig. 4 needs", needed, "N·s/m"),
            Quantity("damping Fig. 7b allows", damping, "N·s/m"),
        ],
        source="percept.haptics.required_damping(Coupling(110e3, 100), 1e-3); percept.haptics.corner_curves",
    )


def middle_impedance(published: Published) -> Claim:
    """Judge Fig. 7d: with and without coupling inside."""
    panel = panels(published)[1]
    lightest, heaviest = _mass_limits(published, panel)
    least_at, most_at = _mass_limits(published, panel, omega=np.array([LOOKED_AT]))
    felt = float(published.through_coupling(panel.wall).stiffness)
    k_low, k_high = panel.wall.stiffness
    inside = min(felt - k_low, k_high - felt)
    return Claim.judged(
        "fig-7d",
        place="Fig. 7d, section 5",
        paper=f"At {panel.wall.name} both lie inside the boundaries, the coupled one lower.",
        cases=_everywhere(published, panel),
        condition=f"the device's mass is below {lightest:.3g} to {heaviest:.3g} kg, depending on its damping",
        finding=f"True over the window for masses up to {lightest:.4g} to {heaviest:.4g} kg, depending on "
        f"the damping; at {LOOKED_AT:g} rad/s alone up to {least_at:.4g} to {most_at:.4g} kg. Through the "
        f"coupling {panel.wall.k:g} N/m feels like {felt:.4g} N/m, and its limits are {k_low:g} to "
        f"{k_high:g} N/m.",
        margin=Quantity("effective stiffness inside its limits by", inside, "N/m"),
        numbers=[
            Quantity("effective stiffness", felt, "N/m"),
            Quantity("largest mass, least", lightest, "kg"),
            Quantity("largest mass, most", heaviest, "kg"),
            Quantity(f"largest mass at {LOOKED_AT:g} rad/s, least", least_at, "kg"),
            Quantity(f"largest mass at {LOOKED_AT:g} rad/s, most", most_at, "kg"),
        ],
        source="percept.reproduce.devices.over_devices; percept.haptics.effective_impedance",
    )


def high_impedance(published: Published) -> Claim:
    """Judge Fig. 7f: without coupling above, with coupling below."""
    panel = panels(published)[2]
    felt = float(published.through_coupling(panel.wall).stiffness)
    k_low, k_high = panel.wall.stiffness
    above = panel.wall.k / k_high - 1
    found = over_devices(published, panel, MASSES, DAMPINGS[:, None])
    return Claim.judged(
        "fig-7f",
        place="Fig. 7f, section 5",
        paper=f"At {panel.wall.name} |Z_h| lies above the boundaries and |Z_h_vc| below.",
        cases=_everywhere(published, panel),
        condition=f"the device is among the {found.mean():.0%} of those tried with which it does",
        finding=f"{panel.wall.k:g} N/m lies above its upper limit {k_high:g} N/m by {above:.2%}; through the "
        f"coupling it feels like {felt:.5g} N/m, {1 - felt / k_low:.1%} below the lower limit {k_low:g} N/m. "
        f"The statement is true of {found.mean():.0%} of the devices tried (m to {MASSES[-1]:g} kg, b_d to "
        f"{DAMPINGS[-1]:g} N·s/m).",
        margin=Quantity("reference above its upper limit", above, "1"),
        numbers=[
            Quantity("effective stiffness", felt, "N/m"),
            Quantity("effective stiffness over lower limit", felt / k_low),
        ],
        source="percept.reproduce.devices.over_devices; percept.haptics.effective_impedance",
    )


def coupling_unnoticed(published: Published) -> Claim:
    """Judge whether the coupling does not matter at very low impedance."""
    panel = panels(published)[0]
    grid = np.meshgrid(MASSES, DAMPINGS)
    omega = np.linspace(*panel.window, 9)
    found = curves(omega, Device(*grid), panel.wall, published.tuned, published.period)
    change = np.abs(found.coupled / found.direct - 1).max(axis=-1)
    band = ((found.upper - found.lower) / found.direct).max(axis=-1)
    return Claim.judged(
        "coupling-unnoticed",
        place="Fig. 7b, section 5",
        paper="In nearly free motion the coupling makes no significant difference.",
        cases=(change < band).ravel(),
        condition=f"the device is among the {np.mean(change < band):.0%} tried with a band wider than "
        f"the change",
        finding=f"Device by device, the coupling changes |Z_h| by at most {(change / band).max():.1%} of the "
        f"band's width. (The largest change is {change.max():.2%} of |Z_h|, with devices whose band is wide; "
        f"the narrowest band has {band.min():.2%}.)",
        margin=Quantity("largest change over the band's width", float((change / band).max()), "1"),
        numbers=[
            Quantity("largest change of |Z_h|", float(change.max()), "1"),
            Quantity("narrowest band over |Z_h|", float(band.min()), "1"),
        ],
        source="percept.haptics.perceived_impedance with and without coupling",
    )


def _everywhere(published: Published, panel: Panel) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return over_devices(published, panel, MASSES, DAMPINGS[:, None]).ravel()


def _mass_limits(
    published: Published, panel: Panel, *, omega: np.ndarray[tuple[int], np.dtype[np.float64]] | None = None
) -> tuple[float, float]:
    """Return the largest mass a panel's statement allows, kg: the least and the most over all dampings."""
    found = []
    for damping in (0.0, *DAMPINGS[::6]):
        fits = partial(over_devices, published, panel, damping=np.array(damping), omega=omega)
        found.append(largest(fits, MASSES) or 0.0)
    return min(found), max(found)


def _extent(published: Published, panel: Panel) -> tuple[float, float]:
    """Return the largest mass whatever the damping, and the largest damping whatever the mass."""
    _, mass = _mass_limits(published, panel)

    def fits(damping: np.ndarray[tuple[int], np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.bool_]]:
        return np.asarray(over_devices(published, panel, _AND_NONE[:, None], damping).any(axis=0))

    return mass, largest(fits, DAMPINGS) or 0.0


def _light(mass: float, damping: float) -> str:
    return f"a mass below {mass:.3g} kg, and less with damping; a damping below {damping:.3g} N·s/m"


def _limit(value: float | None) -> str:
    return listed([]) if value is None else f"{value:.3g}"
