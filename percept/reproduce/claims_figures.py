"""Claims on Figs 4, 5 and 7: which devices they can have been drawn for, and what their curves say."""

from __future__ import annotations

from functools import partial

import numpy as np

from percept.haptics import Device, corner_crossings, corner_curves, environment_impedance
from percept.reproduce.devices import (
    DAMPINGS,
    MASSES,
    BoolArray,
    Panel,
    curves,
    largest,
    over_devices,
    panels,
)
from percept.reproduce.published import (
    LOOKED_AT,
    THEORETICAL,
    Array,
    Claim,
    Published,
    Quantity,
    Wall,
    listed,
)

_AND_NONE = np.concatenate([[0.0], MASSES])


def free_motion(published: Published) -> Claim:
    """Judge Fig. 7b: nearly free motion is displayed below both boundaries."""
    panel = panels(published)[0]
    mass, damping = _extent(published, panel)
    device = published.device
    found = curves(published, panel.wall, np.array([LOOKED_AT]))
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
    needed = published.needed()
    both = over_devices(published, panel, MASSES, np.array(needed))
    heaviest = largest(partial(over_devices, published, panel, damping=np.array(needed)), MASSES)
    return Claim.judged(
        "one-device",
        place="Figs 4 and 7b",
        paper="One device is behind Fig. 4 and Fig. 7b.",
        cases=both,
        condition=f"its mass stays below {'none' if heaviest is None else f'{heaviest:.3g}'} kg",
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
    true = _everywhere(published, panel)
    return Claim.judged(
        "fig-7f",
        place="Fig. 7f, section 5",
        paper=f"At {panel.wall.name} |Z_h| lies above the boundaries and |Z_h_vc| below.",
        cases=true,
        condition=f"the device is among the {true.mean():.0%} of those tried with which it does",
        finding=f"{panel.wall.k:g} N/m lies above its upper limit {k_high:g} N/m by {above:.2%}; through the "
        f"coupling it feels like {felt:.5g} N/m, {1 - felt / k_low:.1%} below the lower limit {k_low:g} N/m. "
        f"The statement is true of {true.mean():.0%} of the devices tried (m to {MASSES[-1]:g} kg, b_d to "
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
    omega = np.linspace(*panel.window, 9)
    found = curves(published, panel.wall, omega, Device(*np.meshgrid(MASSES, DAMPINGS)))
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


def _everywhere(published: Published, panel: Panel) -> BoolArray:
    return over_devices(published, panel, MASSES, DAMPINGS[:, None]).ravel()


def _mass_limits(published: Published, panel: Panel, *, omega: Array | None = None) -> tuple[float, float]:
    """Return the largest mass a panel's statement allows, kg: the least and the most over all dampings."""
    found = []
    for damping in (0.0, *DAMPINGS[::6]):
        fits = partial(over_devices, published, panel, damping=np.array(damping), omega=omega)
        found.append(largest(fits, MASSES) or 0.0)
    return min(found), max(found)


def _extent(published: Published, panel: Panel) -> tuple[float, float]:
    """Return the largest mass whatever the damping, and the largest damping whatever the mass."""
    _, mass = _mass_limits(published, panel)

    def fits(damping: Array) -> BoolArray:
        return np.asarray(over_devices(published, panel, _AND_NONE[:, None], damping).any(axis=0))

    return mass, largest(fits, DAMPINGS) or 0.0


def _light(mass: float, damping: float) -> str:
    return f"a mass below {mass:.3g} kg, and less with damping; a damping below {damping:.3g} N·s/m"


def upper_above(published: Published) -> Claim:
    """Judge whether the curve of the upper limits runs above that of the lower ones."""
    omega, device, period = published.omega(), published.device, published.period
    top = published.scene.frequency.upper
    above, first = [], {}
    for wall in published.walls:
        at_low, at_high = corner_curves(omega, device, wall.stiffness, wall.damping, period)
        above.append(bool((at_high >= at_low).all()))
        crossings = corner_crossings(device, wall.stiffness, wall.damping, period)
        if crossings.size:
            first[wall.name] = float(crossings[0])
    crossing = [name for name in first if first[name] <= top]
    told = ", ".join(f"{value:.4g} ({name})" for name, value in first.items())
    return Claim.judged(
        "upper-above",
        place="Eqs 16, 17, Fig. 5",
        paper="Both upper limits give the upper boundary, both lower ones the lower.",
        cases=above,
        condition=f"ω stays below the crossing, which {listed(crossing)} have inside the perceivable range",
        finding=f"Stiffness raises |Z_h| only where it outweighs the device’s mass. With m = {device.mass:g} "
        f"kg and b_d = {device.damping:g} N·s/m the curves cross at {told} rad/s; there the "
        "band is empty, and beyond it upside down. The exact envelope has no crossing.",
        margin=Quantity("environments whose curves stay apart", sum(above)),
        numbers=[Quantity(f"crossing of {name}", value, "rad/s") for name, value in first.items()],
        source="percept.haptics.corner_crossings(device, k, b, period); magnitude_envelope",
    )


def discrimination(published: Published) -> Claim:
    """Judge whether discrimination is better at low impedance."""
    order = sorted(published.walls, key=lambda wall: wall.k)
    absolute, relative = np.array([_width(wall, published.period) for wall in order]).T
    wider = bool((np.diff(absolute) > 0).all())
    return Claim.judged(
        "discrimination",
        place="Section 5",
        paper="The band is narrow at low impedance and wide at high: people discriminate better there.",
        cases=[wider, (np.diff(relative) > 0).all()],
        condition="widths are absolute; relative to the impedance they do not rise with it"
        if wider
        else "widths are relative to the impedance",
        finding=f"At {LOOKED_AT:g} rad/s, without a device, from the softest wall to the stiffest: widths "
        f"{', '.join(f'{x:.4g}' for x in absolute)} N·s/m, relative to the reference "
        f"{', '.join(f'{x:.3g}' for x in 100 * relative)} %.",
        margin=Quantity("relative width, softest over stiffest wall", float(relative[0] / relative[-1])),
        numbers=[
            Quantity(f"{what} of {wall.name}", float(width), unit)
            for what, widths, unit in (("width", absolute, "N·s/m"), ("relative width", relative, "1"))
            for wall, width in zip(order, widths, strict=True)
        ],
        source="percept.haptics.corner_curves(10, Device(0, 0), k, b, period)",
    )


def _width(wall: Wall, period: float) -> tuple[float, float]:
    """Return how far apart the corner curves of abs(Z_e) are, N·s/m and over the reference."""
    at_low, at_high = corner_curves(LOOKED_AT, Device(0.0, 0.0), wall.stiffness, wall.damping, period)
    width = abs(float(at_high) - float(at_low))
    return width, width / float(np.abs(environment_impedance(LOOKED_AT, wall.environment, period)))


def magnitude_suffices(published: Published) -> Claim:
    """Judge whether an impedance whose magnitude is inside must be one that feels like the reference."""
    same, told = [], []
    for wall in published.walls:
        found = curves(published, wall, np.array([LOOKED_AT]))
        through = published.through_coupling(wall)
        for how, felt, k, b in (
            ("direct", found.direct, wall.k, wall.b),
            ("coupled", found.coupled, float(through.stiffness), float(through.damping)),
        ):
            if not found.lower[0] <= felt[0] <= found.upper[0]:
                continue
            (k_low, k_high), (b_low, b_high) = wall.stiffness, wall.damping
            within = k_low <= k <= k_high and b_low <= b <= b_high
            same.append(within)
            if not within:
                told.append(f"{wall.name}, {how} ({k:.5g} N/m, {b:.4g} N·s/m)")
    return Claim.judged(
        "magnitude-suffices",
        place="Section 3.1, Fig. 7",
        paper="Where |Z_h| is inside the boundary, the interaction feels real.",
        cases=same,
        condition="k and b are inside too",
        finding=f"At {LOOKED_AT:g} rad/s |Z_h| is inside in {len(same)} of {2 * len(published.walls)} cases, "
        f"k and b of {sum(same)} of them. Inside by magnitude alone: {listed(told)}. The magnitude hides the "
        "phase; percept also tests in the plane of (b, k).",
        margin=Quantity("cases inside by magnitude alone", len(same) - sum(same)),
        source="percept.haptics.corner_curves; effective_impedance",
    )


def window_suffices(published: Published) -> Claim:
    """Judge whether what is read off around 10 rad/s is true over the perceivable range."""
    omega, shares, widths = published.omega(), {}, {}
    for panel in panels(published):
        found = curves(published, panel.wall, omega[:, None])
        shares[panel.name] = float(panel.true_of(found).mean())
        low, high = panel.window
        widths[panel.name] = max(high / LOOKED_AT - 1, 1 - low / LOOKED_AT)
    lowest, top = published.scene.frequency.lower, published.scene.frequency.upper
    told = ", ".join(f"{share:.1%} (Fig. {name})" for name, share in shares.items())
    return Claim.judged(
        "window-suffices",
        place="Figs 7b, 7d, 7f, section 5",
        paper="The enlarged figures show what is true of the perceivable range.",
        cases=[share == 1.0 for share in shares.values()],
        condition=f"one means Fig. {listed([name for name, share in shares.items() if share == 1.0])}",
        finding=f"The windows reach {min(widths.values()):.1%} to {max(widths.values()):.1%} around "
        f"{LOOKED_AT:g} rad/s. Of {lowest:g} to {top:g} rad/s (on a logarithmic scale, with the scene’s "
        f"device) the statements are true over {told}.",
        margin=Quantity("smallest share of the range", min(shares.values()), "1"),
        numbers=[Quantity(f"share, Fig. {name}", share, "1") for name, share in shares.items()],
        source="percept.reproduce.devices.curves; percept report (share of the range inside)",
    )


def like_shapes(published: Published) -> Claim:
    """Judge whether higher impedance means a higher curve throughout."""
    omega = published.omega()
    drawn = sorted((wall for wall, _ in published.drawn), key=lambda wall: wall.k)
    felt = np.array([published.felt(omega, wall.environment) for wall in drawn])
    ordered = np.asarray((np.diff(felt, axis=0) > 0).all(axis=0))
    until = float(omega[ordered][-1]) if ordered.any() else 0.0
    return Claim.judged(
        "like-shapes",
        place="Figs 7a, 7c, 7e, section 5",
        paper="|Z_h| is the higher the higher the environment’s impedance.",
        cases=ordered,
        condition=f"ω is below about {until:.3g} rad/s, where the device’s mass takes over",
        finding=f"With m = {published.device.mass:g} kg the order of {listed([wall.name for wall in drawn])} "
        f"is kept over {ordered.mean():.1%} of the range, up to {until:.3g} rad/s.",
        margin=Quantity("share of the range in order", float(ordered.mean()), "1"),
        numbers=[Quantity("ω up to which they are in order", until, "rad/s")],
        source="percept.haptics.perceived_impedance(omega, device, environment, period)",
    )
