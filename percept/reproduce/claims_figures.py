"""Claims on Figs 4, 5 and 7: which devices they can have been drawn for, and what their curves say."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import combinations, product

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
from percept.reproduce.published import LOOKED_AT, Array, Evidence, Published, Wall
from percept.reproduce.squares import cells, felt_square, largest_ratio, share

_AND_NONE = np.concatenate([[0.0], MASSES])
# Statements on curves are linear in mass and damping, so the four corners speak for every device
# between.
_CORNERS = tuple(Device(m, b) for m, b in product((0.0, MASSES[-1]), (0.0, DAMPINGS[-1])))
# A line of 0.35 mm on a panel 60 mm high with six decades covers this ratio.
_LINE = 10 ** (6 * 0.35 / 60)
_RESONANCE = 300.0  # rad/s; section 5 says that resonances lie above


def fig_7b(published: Published) -> Evidence:
    """Judge Fig. 7b: nearly free motion is displayed below both boundaries."""
    panel = panels(published)[0]
    mass, damping = _extent(published, panel)
    found = curves(published, panel.wall, np.array([LOOKED_AT]))
    return {
        "cases": _everywhere(published, panel),
        "mass": mass, "damping": damping, "wall": panel.wall, "limits": panel.wall.stiffness,
        "direct": found.direct[0], "lower": found.lower[0], "upper": found.upper[0],
    }  # fmt: skip


def one_device(published: Published) -> Evidence:
    """Judge whether one rigid device can show both Fig. 4 and Fig. 7b."""
    _, allowed = _extent(published, panels(published)[0])
    needed = published.needed()
    return {
        "cases": [needed <= allowed],
        "ratio": needed / allowed,
        "needed": needed,
        "allowed": allowed,
    }


def fig_7d(published: Published) -> Evidence:
    """Judge Fig. 7d: with and without coupling inside."""
    panel = panels(published)[1]
    lightest, heaviest = _mass_limits(published, panel)
    (felt, _), (low, high) = published.through_coupling(panel.wall), panel.wall.stiffness
    return {
        "cases": _everywhere(published, panel),
        "lightest": lightest, "heaviest": heaviest, "wall": panel.wall, "limits": (low, high),
        "felt": felt, "inside_by": min(felt - low, high - felt),
    }  # fmt: skip


def fig_7f(published: Published) -> Evidence:
    """Judge Fig. 7f: without coupling above, with coupling below."""
    panel = panels(published)[2]
    (felt, _), (low, high) = published.through_coupling(panel.wall), panel.wall.stiffness
    return {
        "cases": [_share_of(published, panel, panel.window, device) == 1.0 for device in _CORNERS],
        "wall": panel.wall, "low": low, "high": high, "felt": felt,
        "above": panel.wall.k / high - 1, "below": 1 - felt / low,
        "mass": MASSES[-1], "damping": DAMPINGS[-1],
    }  # fmt: skip


def coupling_unnoticed(published: Published) -> Evidence:
    """Judge whether the coupling does not matter at very low impedance."""
    panel = panels(published)[0]
    ratio, device = widest_change(published, panel)
    own, _ = widest_change(published, panel, published.device)
    return {
        "cases": [ratio < 1, own < 1],
        "ratio": ratio, "own": own, "mass": float(device.mass), "damping": float(device.damping),
        "most_mass": MASSES[-1], "most_damping": DAMPINGS[-1],
    }  # fmt: skip


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


def upper_above(published: Published) -> Evidence:
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
    return {"cases": above, "crossing": crossing, "first": first, "apart": sum(above)}


def discrimination(published: Published) -> Evidence:
    """Judge whether discrimination is better at low impedance."""
    order = sorted(published.walls, key=lambda wall: wall.k)
    absolute, relative = np.array([_width(wall, published.period) for wall in order]).T
    wider = bool((np.diff(absolute) > 0).all())
    names = [wall.name for wall in order]
    return {
        "cases": [wider, (np.diff(relative) > 0).all()],
        "means": "absolute; relative to the impedance they do not rise with it"
        if wider
        else "relative to the impedance",
        "absolute": absolute, "percent": 100 * relative, "ratio": float(relative[0] / relative[-1]),
        "widths": dict(zip(names, absolute.tolist(), strict=True)),
        "relative_widths": dict(zip(names, relative.tolist(), strict=True)),
    }  # fmt: skip


def _width(wall: Wall, period: float) -> tuple[float, float]:
    """Return how far apart |Z_e| is at the lower and the upper limits, N·s/m and over the reference."""
    pairs = (*zip(wall.stiffness, wall.damping, strict=True), (wall.k, wall.b))
    low, high, own = (
        float(np.abs(environment_impedance(LOOKED_AT, Environment(k, b), period))) for k, b in pairs
    )
    return abs(high - low), abs(high - low) / own


def magnitude_suffices(published: Published) -> Evidence:
    """Judge whether an impedance whose magnitude is inside must be one that feels like the reference."""
    same, told = [], []
    for wall in published.walls:
        found = curves(published, wall, np.array([LOOKED_AT]))
        for how, felt, k, b in (
            ("direct", found.direct, wall.k, wall.b),
            ("coupled", found.coupled, *published.through_coupling(wall)),
        ):
            if not found.lower[0] <= felt[0] <= found.upper[0]:
                continue
            (k_low, k_high), (b_low, b_high) = wall.stiffness, wall.damping
            same.append(k_low <= k <= k_high and b_low <= b <= b_high)
            if not same[-1]:
                told.append(f"{wall.name}, {how} ({k:.5g} N/m, {b:.4g} N·s/m)")
    return {
        "cases": same,
        "inside": len(same), "of": 2 * len(published.walls), "both": sum(same), "told": told,
        "alone": len(same) - sum(same),
    }  # fmt: skip


def window_suffices(published: Published) -> Evidence:
    """Judge whether what is read off around 10 rad/s is true over the perceivable range."""
    span, shown = published.span, panels(published)
    coupled = replace(shown[1], true_of=coupled_inside)
    read = _share_of(published, coupled, span)
    return {
        "cases": [read > 0, read == 1.0],
        "read": read, "window": coupled.window,
        "shares": {f"Fig. {panel.name}": _share_of(published, panel, span) for panel in shown},
    }  # fmt: skip


def like_shapes(published: Published) -> Evidence:
    """Judge whether higher impedance means a higher curve throughout."""
    span, device, period = published.span, published.device, published.period
    drawn = sorted((wall for wall, _ in published.drawn), key=lambda wall: wall.k)
    edges, middles = cells(
        [felt_square(device, wall.k, wall.b, period) for wall in drawn], *span, period
    )
    felt = np.array([published.felt(middles, wall.environment) for wall in drawn])
    ordered = np.asarray((np.diff(felt, axis=0) > 0).all(axis=0))
    return {
        "cases": ordered,
        "names": [wall.name for wall in drawn], "part": share(edges, ordered),
        "until": float(edges[np.append(ordered, False).argmin()]),
    }  # fmt: skip


def four_lines(published: Published) -> Evidence:
    """Judge whether the four lines of Figs 7a, 7c and 7e fall on each other."""
    apart, at_ten = {}, {}
    for panel, letter in zip(panels(published), "ace", strict=True):
        name = f"Fig. 7{letter}"
        squares = panel_squares(published, panel.wall)
        apart[name] = max(
            largest_ratio(one, other, *published.span, published.period)
            for one, other in combinations(squares[::-1], 2)
        )
        found = [
            curves(published, panel.wall, np.array([LOOKED_AT]), device) for device in _CORNERS
        ]
        spread = [np.array([c.lower, c.upper, c.direct, c.coupled]) for c in found]
        at_ten[name] = min(float(lines.max() / lines.min()) for lines in spread)
    worst = max(at_ten, key=at_ten.__getitem__)
    return {
        "cases": [ratio <= _LINE for ratio in apart.values()],
        "hidden": [name for name, ratio in apart.items() if ratio <= _LINE], "line": _LINE,
        "apart": apart, "most": max(apart.values()), "worst": worst, "at_ten": at_ten[worst],
    }  # fmt: skip


def resonance_ignored(published: Published) -> Evidence:
    """Judge whether resonances above 300 rad/s may be ignored below 100."""
    change, at_ten, widths = {}, {}, {}
    for wall, _ in published.drawn:
        rigid, flexible = (
            felt_square(published.device, wall.k, wall.b, published.period, resonance=resonance)
            for resonance in (np.inf, _RESONANCE)
        )
        change[wall.name], at_ten[wall.name] = (
            largest_ratio(rigid, flexible, *span, published.period) - 1
            for span in (published.span, (LOOKED_AT, LOOKED_AT))
        )
        widths[wall.name] = _width(wall, published.period)[1]
    return {
        "cases": [part[name] < widths[name] for part in (change, at_ten) for name in part],
        "told": ", ".join(f"{part:.1%} ({name}, {widths[name]:.1%} wide)" for name, part in change.items()),
        "at_ten": max(at_ten.values()), "most": max(change.values()), "change": change,
    }  # fmt: skip
