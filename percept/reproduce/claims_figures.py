"""Claims on Figs 4, 5 and 7: which devices they can have been drawn for, and what their curves say."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from percept.haptics import Device, Environment, corner_curves, environment_impedance
from percept.haptics.envelope import corner_crossings
from percept.reproduce.devices import (
    DAMPINGS,
    MASSES,
    BoolArray,
    Panel,
    coupled_inside,
    curves,
    largest,
    over_devices,
    panel_squares,
    panels,
    widest_change,
)
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
)
from percept.reproduce.squares import cells, felt_square, largest_ratio, share

_AND_NONE = np.concatenate([[0.0], MASSES])
# Statements on curves are linear in mass and damping, so the four corners speak for every device between.
_CORNERS = tuple(Device(m, b) for m, b in product((0.0, MASSES[-1]), (0.0, DAMPINGS[-1])))
# A line of 0.35 mm on a panel 60 mm high with six decades covers this ratio.
_LINE = 10 ** (6 * 0.35 / 60)
_RESONANCE = 300.0  # rad/s; section 5 says that resonances lie above


def fig_7b(published: Published) -> Judgement:
    """Judge Fig. 7b: nearly free motion is displayed below both boundaries."""
    panel = panels(published)[0]
    mass, damping = _extent(published, panel)
    device = published.device
    found = curves(published, panel.wall, np.array([LOOKED_AT]))
    k_low, k_high = panel.wall.stiffness
    return judged(
        cases=_everywhere(published, panel),
        condition=f"the device has less than {mass:.3g} kg if undamped and less than {damping:.3g} N·s/m if "
        "massless, and less of each if it has both",
        finding=f"With the scene’s device (m = {device.mass:g} kg, b_d = {device.damping:g} N·s/m) |Z_h| is "
        f"{found.direct[0]:.5g} N·s/m at {LOOKED_AT:g} rad/s. The boundaries are {found.lower[0]:.5g} and "
        f"{found.upper[0]:.5g} N·s/m. What the paper calls a minimum impedance is a bias: the limits of k, "
        f"{k_low:g} to {k_high:g} N/m, leave out {panel.wall.k:g} N/m.",
        margin=Quantity("largest mass", mass, "kg"),
        numbers=[Quantity("largest device damping", damping, "N·s/m")],
    )


def one_device(published: Published) -> Judgement:
    """Judge whether one rigid device can show both Fig. 4 and Fig. 7b."""
    _, damping = _extent(published, panels(published)[0])
    needed = published.needed()
    return judged(
        cases=[needed <= damping],
        finding="The sentence puts one device behind both figures, and Eq. 5 makes it rigid. With "
        f"{THEORETICAL.stiffness / 1e3:g} kN/m on its limit, as in Fig. 4, a rigid device has at least "
        f"{needed:.5g} N·s/m. Fig. 7b asks for at most {damping:.4g} N·s/m, whatever the mass. Do not "
        "calibrate one rigid device to both figures. A flexible device might show both.",
        margin=Quantity("damping Fig. 4 needs over what Fig. 7b allows", needed / damping),
        numbers=[
            Quantity("damping Fig. 4 needs", needed, "N·s/m"),
            Quantity("damping Fig. 7b allows", damping, "N·s/m"),
        ],
    )


def fig_7d(published: Published) -> Judgement:
    """Judge Fig. 7d: with and without coupling inside."""
    panel = panels(published)[1]
    lightest, heaviest = _mass_limits(published, panel)
    felt, _ = published.through_coupling(panel.wall)
    k_low, k_high = panel.wall.stiffness
    return judged(
        cases=_everywhere(published, panel),
        condition=f"the device’s mass is below {lightest:.3g} to {heaviest:.3g} kg, depending on its damping",
        finding=f"Through the coupling {panel.wall.k:g} N/m feels like {felt:.4g} N/m, and its limits are "
        f"{k_low:g} to {k_high:g} N/m.",
        margin=Quantity("effective stiffness inside its limits by", min(felt - k_low, k_high - felt), "N/m"),
        numbers=[
            Quantity("effective stiffness", felt, "N/m"),
            Quantity("largest mass, least", lightest, "kg"),
            Quantity("largest mass, most", heaviest, "kg"),
        ],
    )


def fig_7f(published: Published) -> Judgement:
    """Judge Fig. 7f: without coupling above, with coupling below."""
    panel = panels(published)[2]
    felt, _ = published.through_coupling(panel.wall)
    k_low, k_high = panel.wall.stiffness
    above = panel.wall.k / k_high - 1
    return judged(
        cases=[_share_of(published, panel, panel.window, device) == 1.0 for device in _CORNERS],
        condition="the device is among those with which |Z_h| lies above and |Z_h_vc| below",
        finding="The paper sees |Z_h| above the upper boundary and |Z_h_vc| below the lower one. "
        f"{panel.wall.k:g} N/m lies above its upper limit {k_high:g} N/m by {above:.2%}. Through the "
        f"coupling it feels like {felt:.5g} N/m, {1 - felt / k_low:.1%} below the lower limit {k_low:g} N/m. "
        f"The verdict is that of every device up to {MASSES[-1]:g} kg and {DAMPINGS[-1]:g} N·s/m.",
        margin=Quantity("reference above its upper limit", above, "1"),
        numbers=[Quantity("effective stiffness", felt, "N/m")],
    )


def coupling_unnoticed(published: Published) -> Judgement:
    """Judge whether the coupling does not matter at very low impedance."""
    panel = panels(published)[0]
    ratio, device = widest_change(published, panel)
    own, _ = widest_change(published, panel, published.device)
    return judged(
        cases=[ratio < 1, own < 1],
        condition="the device is one whose band is wider than the change",
        finding=f"In the window the coupling changes |Z_h| by at most {ratio:.1%} of the band’s width, with "
        f"any device up to {MASSES[-1]:g} kg and {DAMPINGS[-1]:g} N·s/m. With {device.mass:.3g} kg and "
        f"{device.damping:.3g} N·s/m the boundaries nearly meet. With the scene’s device it is {own:.2%}.",
        margin=Quantity("largest change over the band’s width", ratio, "1"),
        numbers=[
            Quantity("mass with the largest", float(device.mass), "kg"),
            Quantity("damping with the largest", float(device.damping), "N·s/m"),
            Quantity("change over the band’s width, scene’s device", own, "1"),
        ],
    )


def _everywhere(published: Published, panel: Panel) -> BoolArray:
    return over_devices(published, panel, MASSES, DAMPINGS[:, None]).ravel()


def _mass_limits(published: Published, panel: Panel) -> tuple[float, float]:
    """Return the largest mass a panel's statement allows, kg: the least and the most over all dampings."""
    found = []
    for damping in (0.0, *DAMPINGS[::12]):
        fits = partial(over_devices, published, panel, damping=np.array(damping))
        found.append(largest(fits, MASSES) or 0.0)
    return min(found), max(found)


def _extent(published: Published, panel: Panel) -> tuple[float, float]:
    """Return the largest mass whatever the damping, and the largest damping whatever the mass."""
    _, mass = _mass_limits(published, panel)

    def fits(damping: Array) -> BoolArray:
        return np.asarray(over_devices(published, panel, _AND_NONE[:, None], damping).any(axis=0))

    return mass, largest(fits, DAMPINGS) or 0.0


def _share_of(
    published: Published, panel: Panel, span: tuple[float, float], device: Device | None = None
) -> float:
    """Return the share of a span of ω, cut where curves cross, over which a panel's statement is true."""
    edges, middles = cells(panel_squares(published, panel.wall, device), *span, published.period)
    return share(edges, panel.true_of(curves(published, panel.wall, middles[:, None], device)))


def upper_above(published: Published) -> Judgement:
    """Judge whether the curve of the upper limits runs above that of the lower ones."""
    (lowest, top), device, period = published.span, published.device, published.period
    above, first = [], {}
    for wall in published.walls:
        crossings = corner_crossings(device, wall.stiffness, wall.damping, period)
        at_low, at_high = corner_curves(lowest, device, wall.stiffness, wall.damping, period)
        within = (crossings > lowest) & (crossings < top)
        above.append(bool(at_high >= at_low) and not within.any())
        if crossings.size:
            first[wall.name] = float(crossings[0])
    crossing = [name for name in first if first[name] <= top]
    told = ", ".join(f"{value:.4g} ({name})" for name, value in first.items())
    return judged(
        cases=above,
        condition=f"ω stays below the crossing, which {listed(crossing)} have inside the perceivable range",
        finding=f"Stiffness raises |Z_h| only where it outweighs the device’s mass. With m = {device.mass:g} "
        f"kg and b_d = {device.damping:g} N·s/m the curves cross at {told} rad/s. At the crossing the band "
        "is empty, and beyond it upside down. The exact envelope has no crossing.",
        margin=Quantity("environments whose curves stay apart", sum(above)),
        numbers=[Quantity(f"crossing of {name}", value, "rad/s") for name, value in first.items()],
    )


def discrimination(published: Published) -> Judgement:
    """Judge whether discrimination is better at low impedance."""
    order = sorted(published.walls, key=lambda wall: wall.k)
    absolute, relative = np.array([_width(wall, published.period) for wall in order]).T
    wider = bool((np.diff(absolute) > 0).all())
    return judged(
        cases=[wider, (np.diff(relative) > 0).all()],
        condition="widths are absolute; relative to the impedance they do not rise with it"
        if wider
        else "widths are relative to the impedance",
        finding="From the softest wall to the stiffest the widths in |Z_e| are "
        f"{', '.join(f'{x:.4g}' for x in absolute)} N·s/m at {LOOKED_AT:g} rad/s. Relative to the reference "
        f"they are {', '.join(f'{x:.3g}' for x in 100 * relative)} %.",
        margin=Quantity("relative width, softest over stiffest wall", float(relative[0] / relative[-1])),
        numbers=[
            Quantity(f"{what} of {wall.name}", float(width), unit)
            for what, widths, unit in (("width", absolute, "N·s/m"), ("relative width", relative, "1"))
            for wall, width in zip(order, widths, strict=True)
        ],
    )


def _width(wall: Wall, period: float) -> tuple[float, float]:
    """Return how far apart |Z_e| is at the lower and the upper limits, N·s/m and over the reference."""
    pairs = (*zip(wall.stiffness, wall.damping, strict=True), (wall.k, wall.b))
    low, high, own = (
        float(np.abs(environment_impedance(LOOKED_AT, Environment(k, b), period))) for k, b in pairs
    )
    return abs(high - low), abs(high - low) / own


def magnitude_suffices(published: Published) -> Judgement:
    """Judge whether an impedance whose magnitude is inside must be one that feels like the reference."""
    same, told = [], []
    for wall in published.walls:
        found = curves(published, wall, np.array([LOOKED_AT]))
        through = published.through_coupling(wall)
        for how, felt, k, b in (
            ("direct", found.direct, wall.k, wall.b),
            ("coupled", found.coupled, *through),
        ):
            if not found.lower[0] <= felt[0] <= found.upper[0]:
                continue
            (k_low, k_high), (b_low, b_high) = wall.stiffness, wall.damping
            within = k_low <= k <= k_high and b_low <= b <= b_high
            same.append(within)
            if not within:
                told.append(f"{wall.name}, {how} ({k:.5g} N/m, {b:.4g} N·s/m)")
    return judged(
        cases=same,
        condition="k and b are inside too",
        finding=f"At {LOOKED_AT:g} rad/s |Z_h| is inside in {len(same)} of {2 * len(published.walls)} cases, "
        f"k and b of {sum(same)} of them. Inside by magnitude alone: {listed(told)}. The magnitude hides the "
        "phase; percept also tests in the plane of (b, k).",
        margin=Quantity("cases inside by magnitude alone", len(same) - sum(same)),
    )


def window_suffices(published: Published) -> Judgement:
    """Judge whether what is read off around 10 rad/s is true over the perceivable range."""
    span, shown = published.span, panels(published)
    shares = {panel.name: _share_of(published, panel, span) for panel in shown}
    coupled = replace(shown[1], true_of=coupled_inside)
    read = _share_of(published, coupled, span)
    told = ", ".join(f"{part:.1%} (Fig. {name})" for name, part in shares.items())
    lowest, highest = coupled.window
    return judged(
        cases=[read > 0, read == 1.0],
        condition=f"ω stays in that {read:.1%} of the perceivable range where it is so",
        finding=f"The sentence names no ω, and Fig. 7d shows {lowest:g} to {highest:g} rad/s. With the "
        f"scene’s device |Z_h_vc| is inside over {read:.1%} of {span[0]:g} to {span[1]:g} rad/s on a log "
        f"scale. What the paper reads off all curves is true over {told}.",
        margin=Quantity("share of the range with |Z_h_vc| inside", read, "1"),
        numbers=[Quantity(f"share, Fig. {name}", part, "1") for name, part in shares.items()],
    )


def like_shapes(published: Published) -> Judgement:
    """Judge whether higher impedance means a higher curve throughout."""
    span, device, period = published.span, published.device, published.period
    drawn = sorted((wall for wall, _ in published.drawn), key=lambda wall: wall.k)
    edges, middles = cells([felt_square(device, wall.k, wall.b, period) for wall in drawn], *span, period)
    felt = np.array([published.felt(middles, wall.environment) for wall in drawn])
    ordered = np.asarray((np.diff(felt, axis=0) > 0).all(axis=0))
    part = share(edges, ordered)
    until = float(edges[np.append(ordered, False).argmin()])
    return judged(
        cases=ordered,
        condition=f"ω is below {until:.4g} rad/s, where the device’s mass takes over",
        finding=f"With m = {device.mass:g} kg the curves of {listed([wall.name for wall in drawn])} keep "
        f"their order over {part:.1%} of the range, up to {until:.4g} rad/s.",
        margin=Quantity("share of the range in order", part, "1"),
        numbers=[Quantity("ω up to which they are in order", until, "rad/s")],
    )


def four_lines(published: Published) -> Judgement:
    """Judge whether the four lines of Figs 7a, 7c and 7e fall on each other."""
    apart, at_ten = {}, {}
    for panel, letter in zip(panels(published), "ace", strict=True):
        squares = panel_squares(published, panel.wall)
        pairs = [(one, other) for i, one in enumerate(squares) for other in squares[:i]]
        apart[letter] = max(
            largest_ratio(one, other, *published.span, published.period) for one, other in pairs
        )
        found = [curves(published, panel.wall, np.array([LOOKED_AT]), device) for device in _CORNERS]
        spread = [np.array([c.lower, c.upper, c.direct, c.coupled]) for c in found]
        at_ten[letter] = min(float(lines.max() / lines.min()) for lines in spread)
    told = ", ".join(f"{ratio:.3g} (Fig. 7{letter})" for letter, ratio in apart.items())
    worst = max(at_ten, key=at_ten.__getitem__)
    return judged(
        cases=[ratio <= _LINE for ratio in apart.values()],
        condition="one looks at "
        + listed([f"Fig. 7{letter}" for letter, ratio in apart.items() if ratio <= _LINE]),
        finding=f"A line of 0.35 mm hides a ratio of {_LINE:.3g} on a panel 60 mm high with six decades. "
        f"With the scene’s device the highest of the four lines is up to {told} times the lowest. In Fig. "
        f"7{worst} the ratio at {LOOKED_AT:g} rad/s is {at_ten[worst]:.3g} or more with the lightest and "
        "heaviest devices.",
        margin=Quantity("largest ratio of two lines", max(apart.values())),
        numbers=[Quantity(f"largest ratio, Fig. 7{letter}", ratio) for letter, ratio in apart.items()],
    )


def resonance_ignored(published: Published) -> Judgement:
    """Judge whether resonances above 300 rad/s may be ignored below 100."""
    span, period = published.span, published.period
    change, at_ten, widths = {}, {}, {}
    for wall, _ in published.drawn:
        rigid, flexible = (
            felt_square(published.device, wall.k, wall.b, period, resonance=resonance)
            for resonance in (np.inf, _RESONANCE)
        )
        change[wall.name] = largest_ratio(rigid, flexible, *span, period) - 1
        at_ten[wall.name] = largest_ratio(rigid, flexible, LOOKED_AT, LOOKED_AT, period) - 1
        widths[wall.name] = _width(wall, period)[1]
    told = ", ".join(f"{part:.1%} ({name}, {widths[name]:.1%} wide)" for name, part in change.items())
    return judged(
        cases=[part[name] < widths[name] for part in (change, at_ten) for name in part],
        condition=f"ω is near {LOOKED_AT:g} rad/s, or most of the device’s mass is rigid",
        finding=f"Put the scene’s mass on a mode at {_RESONANCE:g} rad/s. Below {span[1]:g} rad/s |Z_h| then "
        f"changes by up to {told}; widths belong to the bands at {LOOKED_AT:g} rad/s. There it changes by "
        f"{max(at_ten.values()):.2%} at most. Eq. 10 must hold at every ω, so Fig. 4 cannot ignore a "
        "resonance.",
        margin=Quantity("largest change of |Z_h| by the mode", max(change.values()), "1"),
        numbers=[Quantity(f"largest change, {name}", part, "1") for name, part in change.items()],
    )
