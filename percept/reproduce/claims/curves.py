"""Claims on the boundaries over ω: what is above what, how wide, and where it was looked at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.haptics import (
    Device,
    corner_crossings,
    corner_curves,
    environment_impedance,
    perceived_impedance,
)
from percept.reproduce.claims.record import Claim, Quantity, listed
from percept.reproduce.devices import curves, panels
from percept.reproduce.published import LOOKED_AT, Published, Wall

FloatArray = NDArray[np.float64]


def upper_above(published: Published) -> Claim:
    """Judge whether the curve of the upper limits runs above that of the lower ones."""
    omega, device, period = published.omega(), published.device, published.period
    top = published.scene.frequency.upper
    above = []
    for wall in published.walls:
        at_low, at_high = corner_curves(omega, device, wall.stiffness, wall.damping, period)
        above.append(bool((at_high >= at_low).all()))
    crossings = {
        wall.name: corner_crossings(device, wall.stiffness, wall.damping, period) for wall in published.walls
    }
    first = {name: float(found[0]) for name, found in crossings.items() if found.size}
    crossing = [name for name in first if first[name] <= top]
    return Claim.judged(
        "upper-above",
        place="Eqs 16, 17, Fig. 5",
        paper="Both upper limits give the upper boundary, both lower ones the lower.",
        cases=above,
        condition=f"ω stays below the crossing, which {listed(crossing)} have inside the perceivable range",
        finding=f"Stiffness raises |Z_h| only where it outweighs the device’s mass. With m = {device.mass:g} "
        f"kg and b_d = {device.damping:g} N·s/m the curves cross at "
        + ", ".join(f"{value:.4g} ({name})" for name, value in first.items())
        + " rad/s; there the band is empty, and beyond it upside down. The exact envelope has no crossing.",
        margin=Quantity("environments whose curves stay apart", sum(above)),
        numbers=[Quantity(f"crossing of {name}", value, "rad/s") for name, value in first.items()],
        source="percept.haptics.corner_crossings(device, k, b, period); magnitude_envelope",
    )


def discrimination(published: Published) -> Claim:
    """Judge whether discrimination is better at low impedance."""
    order = sorted(published.walls, key=lambda wall: wall.k)
    absolute, relative = np.array([_width(wall, published.period) for wall in order]).T
    wider = [bool(x) for x in np.diff(absolute) > 0]
    coarser = [bool(x) for x in np.diff(relative) > 0]
    return Claim.judged(
        "discrimination",
        place="Section 5",
        paper="The band is narrow at low impedance and wide at high: people discriminate better there.",
        cases=[all(wider), all(coarser)],
        condition="widths are absolute; relative to the impedance they do not rise with it"
        if all(wider)
        else "widths are relative to the impedance",
        finding=f"At {LOOKED_AT:g} rad/s, without a device, from the softest wall to the stiffest: widths "
        f"{', '.join(f'{x:.4g}' for x in absolute)} N·s/m, relative to the reference "
        f"{', '.join(f'{x:.3g}' for x in 100 * relative)} %.",
        margin=Quantity("relative width, softest over stiffest wall", float(relative[0] / relative[-1])),
        numbers=[
            *(
                Quantity(f"width of {w.name}", float(x), "N·s/m")
                for w, x in zip(order, absolute, strict=True)
            ),
            *(
                Quantity(f"relative width of {w.name}", float(x), "1")
                for w, x in zip(order, relative, strict=True)
            ),
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
        found = curves(np.array([LOOKED_AT]), published.device, wall, published.tuned, published.period)
        shown = published.through_coupling(wall)
        for how, felt, k, b in (
            ("direct", found.direct, wall.k, wall.b),
            ("coupled", found.coupled, float(shown.stiffness), float(shown.damping)),
        ):
            if not found.lower[0] <= felt[0] <= found.upper[0]:
                continue
            within = _inside(k, wall.stiffness) and _inside(b, wall.damping)
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


def _inside(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def window_suffices(published: Published) -> Claim:
    """Judge whether what is read off around 10 rad/s is true over the perceivable range."""
    omega, shares, widths = published.omega(), {}, {}
    for panel in panels(published):
        found = curves(omega[:, None], published.device, panel.wall, published.tuned, published.period)
        shares[panel.name] = float(panel.true_of(found).mean())
        low, high = panel.window
        widths[panel.name] = max(high / LOOKED_AT - 1, 1 - low / LOOKED_AT)
    lowest, top = published.scene.frequency.lower, published.scene.frequency.upper
    return Claim.judged(
        "window-suffices",
        place="Figs 7b, 7d, 7f, section 5",
        paper="The enlarged figures show what is true of the perceivable range.",
        cases=[share == 1.0 for share in shares.values()],
        condition=f"one means Fig. {listed([name for name, share in shares.items() if share == 1.0])}",
        finding=f"The windows reach {min(widths.values()):.1%} to {max(widths.values()):.1%} around "
        f"{LOOKED_AT:g} rad/s. Of {lowest:g} to {top:g} rad/s (on a logarithmic scale, with the scene’s "
        "device) the statements are true over "
        + ", ".join(f"{share:.1%} (Fig. {name})" for name, share in shares.items())
        + ".",
        margin=Quantity("smallest share of the range", min(shares.values()), "1"),
        numbers=[Quantity(f"share, Fig. {name}", share, "1") for name, share in shares.items()],
        source="percept.reproduce.devices.curves; percept report (share of the range inside)",
    )


def like_shapes(published: Published) -> Claim:
    """Judge whether higher impedance means a higher curve throughout."""
    omega = published.omega()
    drawn = sorted((wall for wall, _ in published.drawn), key=lambda wall: wall.k)
    felt = np.array(
        [
            np.abs(perceived_impedance(omega, published.device, wall.environment, published.period))
            for wall in drawn
        ]
    )
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
