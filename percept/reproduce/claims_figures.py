"""Claims on Figs 4, 5 and 7: which devices they can have been drawn for, and what their curves say."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import brentq

from percept.haptics import (
    Device,
    Environment,
    corner_curves,
    magnitude_envelope,
    required_damping_at,
)
from percept.haptics.envelope import corner_crossings
from percept.reproduce.devices import (
    DAMPINGS,
    MASSES,
    BoolArray,
    Panel,
    absolute_width,
    change_over_band,
    coupled_inside,
    curves,
    largest,
    most_passed,
    over_devices,
    panels,
    relative_width,
    share_true,
)
from percept.reproduce.published import LOOKED_AT, THEORETICAL, Array, Evidence, Published, Wall
from percept.reproduce.squares import cells, felt_square, largest_ratio, share

_AND_NONE = np.concatenate([[0.0], MASSES])
_SAME = 1e-9  # Relative difference of two ways to one number
_THICKNESS = 0.35  # mm, of a printed line
_DECADE = 10.0  # mm: a panel 60 mm high shows six decades
_LINE = 10 ** (_THICKNESS / _DECADE)  # The ratio of two curves that one line covers
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
    """Say why nobody can judge that resonances make the knots of Fig. 4, and that no rigid device does."""
    _, allowed = _extent(published, panels(published)[0])
    needed = published.needed()
    at_ten = float(required_damping_at(LOOKED_AT, THEORETICAL, published.period))
    return {
        "ratio": needed / allowed,
        "needed": needed,
        "allowed": allowed,
        "at_ten": at_ten,
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
    # |Z_h|² of two curves differ linearly in mass and damping: the four corners speak for every
    # device between.
    corner_masses = np.array([0.0, MASSES[-1]])
    corner_dampings = np.array([[0.0], [DAMPINGS[-1]]])
    (felt, _), (low, high) = published.through_coupling(panel.wall), panel.wall.stiffness
    return {
        "cases": over_devices(published, panel, corner_masses, corner_dampings).ravel(),
        "wall": panel.wall, "low": low, "high": high, "felt": felt,
        "above": panel.wall.k / high - 1, "below": 1 - felt / low,
        "mass": MASSES[-1], "damping": DAMPINGS[-1],
    }  # fmt: skip


def coupling_unnoticed(published: Published) -> Evidence:
    """Judge whether the coupling does not matter at very low impedance."""
    panel = panels(published)[0]
    part, device = most_passed(published, panel)
    own = float(change_over_band(published, panel, published.device).max())
    return {
        "cases": [part == 0, own < 1],
        "part": part, "own": own, "mass": float(device.mass), "damping": float(device.damping),
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


def arbitrary_model(published: Published) -> Evidence:
    """Judge whether limits of any model's parameters give its boundaries, by a mass that resonates."""
    massless, resonant, masses = {}, {}, {}
    for wall in published.walls:
        masses[wall.name] = wall.k / LOOKED_AT**2
        massless[wall.name] = _ends(published, wall, 0.0)
        resonant[wall.name] = _ends(published, wall, masses[wall.name])
    worst = max(resonant, key=lambda name: resonant[name].at_low / resonant[name].at_high)
    ends = resonant[worst]
    right = [name for name, each in massless.items() if each.right]
    fine = [name for name, each in resonant.items() if each.right]
    return {
        "cases": [each.right for each in (*massless.values(), *resonant.values())],
        "massless": len(right),
        "of": len(massless),
        "fine": fine,
        "worst": worst,
        "mass": masses[worst],
        "at_low": ends.at_low,
        "at_high": ends.at_high,
        "ratio": ends.at_low / ends.at_high,
        "lower": ends.lower,
        "upper": ends.upper,
    }


@dataclass(frozen=True)
class _Ends:
    """|Z_e| at 10 rad/s, N·s/m: of the paper's two corners, and the exact limits over the box."""

    at_low: float
    at_high: float
    lower: float
    upper: float

    @property
    def right(self) -> bool:
        """Whether the corners are the exact limits."""
        return bool(np.allclose([self.at_low, self.at_high], [self.lower, self.upper], rtol=_SAME))


def _ends(published: Published, wall: Wall, mass: float) -> _Ends:
    """Return corners and exact limits of an environment with a mass, felt without a device."""
    period, nothing = published.period, Device(0.0, 0.0)
    corners = [
        published.felt(LOOKED_AT, Environment(k, b, mass), device=nothing)
        for k, b in zip(wall.stiffness, wall.damping, strict=True)
    ]
    exact = magnitude_envelope(LOOKED_AT, nothing, wall.stiffness, wall.damping, period, mass=mass)
    return _Ends(*map(float, (*corners, *exact)))


def discrimination(published: Published) -> Evidence:
    """Judge whether discrimination is better at low impedance."""
    order = sorted(published.walls, key=lambda wall: wall.k)
    absolute = np.array([absolute_width(wall, published.period) for wall in order])
    relative = np.array([relative_width(wall, published.period) for wall in order])
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


def magnitude_suffices(published: Published) -> Evidence:
    """Judge whether a magnitude inside makes an impedance feel like the reference."""
    least, told = {}, []
    for wall in published.walls:
        found = curves(published, wall, np.array([LOOKED_AT]))
        ends = [_damper_of(published, float(limit[0])) for limit in (found.lower, found.upper)]
        if ends[1] is not None:
            low = ends[0] or 0.0
            least[wall.name] = low
            told.append(f"{low:.4g} to {ends[1]:.4g} N·s/m ({wall.name})")
    return {
        "cases": [wall.name not in least for wall in published.walls],
        "fooled": list(least), "least": least, "told": told, "alone": len(least),
    }  # fmt: skip


def _damper_of(published: Published, magnitude: float) -> float | None:
    """Return the damper, N·s/m, with which |Z_h| has a magnitude at 10 rad/s; None if that is too low."""

    def excess(damping: float) -> float:
        return float(published.felt(LOOKED_AT, Environment(0.0, damping))) - magnitude

    return brentq(excess, 0.0, 2 * magnitude) if excess(0.0) <= 0 else None


def window_suffices(published: Published) -> Evidence:
    """Judge whether what is read off around 10 rad/s is true over the perceivable range."""
    shown = panels(published)
    read = share_true(published, shown[1].wall, coupled_inside)
    shares = {
        f"Fig. {panel.name}": share_true(published, panel.wall, panel.true_of) for panel in shown
    }
    return {
        "cases": [read > 0, read == 1.0],
        "read": read,
        "window": shown[1].window,
        "shares": shares,
    }


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
    """Judge whether the four lines of Figs 7a, 7c and 7e fall on each other where the paper enlarges them."""
    devices = Device(_AND_NONE, np.append(0.0, DAMPINGS)[:, None])
    least = {}
    for panel, letter in zip(panels(published), "ace", strict=True):
        found = curves(published, panel.wall, np.array([LOOKED_AT]), devices)
        highest = np.maximum(np.maximum(found.upper, found.direct), found.coupled)
        lowest = np.minimum(np.minimum(found.lower, found.direct), found.coupled)
        least[f"Fig. 7{letter}"] = float((highest / lowest).min())
    worst = max(least, key=least.__getitem__)
    return {
        "cases": [ratio <= _LINE for ratio in least.values()],
        "hidden": [name for name, ratio in least.items() if ratio <= _LINE],
        "thickness": _THICKNESS,
        "line": _LINE,
        "least": least,
        "worst": worst,
        "most": least[worst],
        "needed": _DECADE * float(np.log10(least[worst])),
        "mass": MASSES[-1],
        "damping": DAMPINGS[-1],
    }


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
        widths[wall.name] = relative_width(wall, published.period)
    return {
        "cases": [part[name] < widths[name] for part in (change, at_ten) for name in part],
        "told": ", ".join(f"{part:.1%} ({name}, {widths[name]:.1%} wide)" for name, part in change.items()),
        "at_ten": max(at_ten.values()), "most": max(change.values()), "change": change,
    }  # fmt: skip
