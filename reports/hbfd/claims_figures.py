"""Claims on Figs 4, 5 and 7: which devices can show them, and what their curves say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import brentq

from percept.haptics import (
    Device,
    Environment,
    Loop,
    Mode,
    corner_curves,
    magnitude_envelope,
    required_damping_at,
)
from reports.hbfd.devices import (
    DAMPINGS,
    MASSES,
    BoolArray,
    Panel,
    absolute_width,
    coupled_inside,
    curves,
    largest,
    over_devices,
    panels,
    relative_width,
    share_true,
)
from reports.hbfd.published import (
    LOOKED_AT,
    THEORETICAL,
    Array,
    Evidence,
    Published,
    Wall,
    evidence,
)

_MASSLESS_TOO = np.append(0.0, MASSES)
_UNDAMPED_TOO = np.append(0.0, DAMPINGS)
_NO_DEVICE = Device(0.0, 0.0)
_SAME = 1e-9  # Relative difference of two ways to one number
_AT = np.array([LOOKED_AT])
_THICKNESS = 0.35  # mm, of a printed line
_DECADE = 10.0  # mm: a panel 60 mm high shows six decades
_LINE = 10 ** (_THICKNESS / _DECADE)  # The ratio of two curves that one line covers
_RESONANCE = 300.0  # rad/s; section 5 says that resonances lie above


def fig_7b(published: Published) -> Evidence:
    """Judge Fig. 7b: nearly free motion is displayed below both boundaries."""
    panel, _, _ = panels(published)
    mass, damping = _extent(published, panel)
    lines = curves(published, panel.wall, _AT)
    return evidence(
        _everywhere(published, panel),
        mass=mass,
        damping=damping,
        wall=panel.wall,
        lines=lines,
    )


def one_device(published: Published) -> Evidence:
    """Say why nobody can judge the knots of Fig. 4, and that no rigid device has them."""
    panel, _, _ = panels(published)
    _, allowed = _extent(published, panel)
    needed = published.needed()
    at_ten = float(required_damping_at(published.loop, LOOKED_AT, THEORETICAL))
    return evidence(None, ratio=needed / allowed, needed=needed, allowed=allowed, at_ten=at_ten)


def fig_7d(published: Published) -> Evidence:
    """Judge Fig. 7d: with and without coupling inside."""
    _, panel, _ = panels(published)
    lightest, heaviest = _mass_limits(published, panel)
    felt, _ = published.through_coupling(panel.wall)
    low, high = panel.wall.stiffness
    return evidence(
        _everywhere(published, panel),
        lightest=lightest,
        heaviest=heaviest,
        wall=panel.wall,
        felt=felt,
        inside_by=min(felt - low, high - felt),
    )


def fig_7f(published: Published) -> Evidence:
    """Judge Fig. 7f: without coupling above, with coupling below."""
    _, _, panel = panels(published)
    felt, _ = published.through_coupling(panel.wall)
    low, high = panel.wall.stiffness
    # |Z_h|² of two curves differ linearly in mass and damping: the four corners speak for every
    # device between.
    masses = np.array([0.0, MASSES[-1]])
    dampings = np.array([0.0, DAMPINGS[-1]])
    cases = over_devices(published, panel, masses, dampings[:, None]).ravel()
    return evidence(
        cases,
        wall=panel.wall,
        felt=felt,
        above=panel.wall.k / high - 1,
        below=1 - felt / low,
    )


def _everywhere(published: Published, panel: Panel) -> BoolArray:
    return over_devices(published, panel, MASSES, DAMPINGS[:, None]).ravel()


def _mass_limits(published: Published, panel: Panel) -> tuple[float, float]:
    """Return the largest mass a panel's statement allows, kg: least and most over dampings."""
    limits = []
    for damping in (0.0, *DAMPINGS[::12].tolist()):
        fits = partial(over_devices, published, panel, damping=np.array(damping))
        limits.append(largest(fits, MASSES) or 0.0)
    return min(limits), max(limits)


def _extent(published: Published, panel: Panel) -> tuple[float, float]:
    """Return the largest mass whatever the damping, and the largest damping whatever the mass."""
    _, mass = _mass_limits(published, panel)

    def fits(damping: Array) -> BoolArray:
        fitting = over_devices(published, panel, _MASSLESS_TOO[:, None], damping)
        return np.asarray(fitting.any(axis=0))

    return mass, largest(fits, DAMPINGS) or 0.0


def upper_above(published: Published) -> Evidence:
    """Judge whether the curve of the upper limits runs above that of the lower ones."""
    bottom, top = published.span
    cases = []
    first = {}
    omega = np.geomspace(bottom, published.loop.nyquist, 4001)[:-1]
    for wall in published.walls:

        def gap(omega: Any, wall: Wall = wall) -> Any:
            low, high = corner_curves(published.loop, omega, wall.stiffness, wall.damping)
            return high - low

        above = gap(omega) >= 0
        cases.append(bool(above[omega < top].all()))
        if not above.all():
            crossed = omega[above.argmin()]
            first[wall.name] = brentq(gap, 0.99 * crossed, crossed, xtol=1e-12)
    crossing = [name for name, omega in first.items() if omega <= top]
    return evidence(cases, crossing=crossing, first=first, apart=sum(cases))


def arbitrary_model(published: Published) -> Evidence:
    """Judge whether limits of any model's parameters give boundaries, by a mass that resonates."""
    massless = []
    resonant = []
    for wall in published.walls:
        massless.append(_ends(published, wall, 0.0))
        resonant.append(_ends(published, wall, wall.k / LOOKED_AT**2))
    cases = [ends.right for ends in massless + resonant]
    right = [ends.name for ends in massless if ends.right]
    fine = [ends.name for ends in resonant if ends.right]
    worst = max(resonant, key=lambda ends: ends.ratio)
    return evidence(cases, massless=len(right), of=len(massless), fine=fine, worst=worst)


@dataclass(frozen=True)
class _Ends:
    """|Z_e| of an environment at 10 rad/s, N·s/m: at the paper's corners, and its exact limits."""

    name: str
    mass: float  # kg
    at_low: float
    at_high: float
    lower: float
    upper: float

    @property
    def ratio(self) -> float:
        return self.at_low / self.at_high

    @property
    def right(self) -> bool:
        """Whether the corners are the exact limits."""
        low = math.isclose(self.at_low, self.lower, rel_tol=_SAME)
        return low and math.isclose(self.at_high, self.upper, rel_tol=_SAME)


def _ends(published: Published, wall: Wall, mass: float) -> _Ends:
    """Return corners and exact limits of an environment with a mass, felt without a device."""

    def corner(limits: Environment) -> float:
        environment = Environment(limits.stiffness, limits.damping, mass)
        return float(published.felt(LOOKED_AT, environment, device=_NO_DEVICE))

    at_low = corner(wall.lower)
    at_high = corner(wall.upper)
    lower, upper = magnitude_envelope(
        Loop(_NO_DEVICE, published.period), LOOKED_AT, wall.stiffness, wall.damping, mass=mass
    )
    return _Ends(wall.name, mass, at_low, at_high, float(lower), float(upper))


def discrimination(published: Published) -> Evidence:
    """Judge whether discrimination is better at low impedance."""
    widths = {}
    relative_widths = {}
    for wall in published.softest_first:
        widths[wall.name] = absolute_width(wall, published.period)
        relative_widths[wall.name] = relative_width(wall, published.period)
    relative = list(relative_widths.values())
    percent = [100 * width for width in relative]
    wider = _rises(widths)
    means = "relative to the impedance"
    if wider:
        means = "absolute; relative to the impedance they do not rise with it"
    return evidence(
        [wider, _rises(relative_widths)],
        means=means,
        absolute=list(widths.values()),
        percent=percent,
        ratio=relative[0] / relative[-1],
        widths=widths,
        relative_widths=relative_widths,
    )


def _rises(values: dict[str, float]) -> bool:
    return bool((np.diff(list(values.values())) > 0).all())


def magnitude_suffices(published: Published) -> Evidence:
    """Judge whether a magnitude inside makes an impedance feel like the reference."""
    least = {}
    told = []
    for wall in published.walls:
        lines = curves(published, wall, _AT)
        high = _damper_of(published, float(lines.upper[0]))
        if high is not None:
            low = _damper_of(published, float(lines.lower[0])) or 0.0
            least[wall.name] = low
            told.append(f"{low:.4g} to {high:.4g} N·s/m ({wall.name})")
    cases = [wall.name not in least for wall in published.walls]
    return evidence(cases, fooled=list(least), least=least, told=told, alone=len(least))


def _damper_of(published: Published, magnitude: float) -> float | None:
    """Return the damper, N·s/m, that gives |Z_h| a magnitude at 10 rad/s; None if there is none."""

    def excess(damping: float) -> float:
        return float(published.felt(LOOKED_AT, Environment(0.0, damping))) - magnitude

    return brentq(excess, 0.0, 2 * magnitude) if excess(0.0) <= 0 else None


def window_suffices(published: Published) -> Evidence:
    """Judge whether what is read off around 10 rad/s is true over the perceivable range."""
    shares = {
        f"Fig. {panel.name}": share_true(published, panel.wall, panel.reading)
        for panel in panels(published)
    }
    _, panel, _ = panels(published)
    read = share_true(published, panel.wall, coupled_inside)
    cases = [read > 0, read == 1.0]
    return evidence(cases, read=read, window=panel.window, shares=shares)


def like_shapes(published: Published) -> Evidence:
    """Judge whether higher impedance means higher curves throughout, all four of a panel."""
    drawn = [wall for wall, _ in published.drawn]
    drawn.sort(key=lambda wall: wall.k)

    def ordered(omega: Array) -> BoolArray:
        lines = [curves(published, wall, omega) for wall in drawn]
        in_order = np.ones(omega.size, dtype=bool)
        for name in ("lower", "upper", "direct", "coupled"):
            steps = np.diff([getattr(one, name) for one in lines], axis=0)
            in_order &= (steps > 0).all(axis=0)
        return in_order

    in_order = ordered(published.omega())
    return evidence(
        in_order,
        names=[wall.name for wall in drawn],
        fraction=float(in_order.mean()),
        until=largest(ordered, published.omega()) or 0.0,
    )


def four_lines(published: Published) -> Evidence:
    """Judge whether the four lines of Figs 7a, 7c and 7e fall on each other at 10 rad/s."""
    devices = Device(_MASSLESS_TOO, _UNDAMPED_TOO[:, None])
    least = {}
    for panel, letter in zip(panels(published), "ace", strict=True):
        lines = curves(published, panel.wall, _AT, devices)
        magnitudes = np.array([lines.lower, lines.upper, lines.direct, lines.coupled])
        ratios = magnitudes.max(axis=0) / magnitudes.min(axis=0)
        least[f"Fig. 7{letter}"] = float(ratios.min())
    worst = max(least, key=least.__getitem__)
    hidden = [name for name, ratio in least.items() if ratio <= _LINE]
    return evidence(
        [name in hidden for name in least],
        hidden=hidden,
        thickness=_THICKNESS,
        line=_LINE,
        least=least,
        worst=worst,
        most=least[worst],
        needed=_DECADE * float(np.log10(least[worst])),
    )


def resonance_ignored(published: Published) -> Evidence:
    """Judge whether resonances above 300 rad/s may be ignored below 100."""
    device = published.device
    mass = float(device.mass)
    flexible = Device(0.0, device.damping, (Mode(mass, mass * _RESONANCE**2, 0.0),))
    cases = []
    change = {}
    told = []
    most_at_ten = 0.0
    for wall, _ in published.drawn:

        def changed(omega: Array, wall: Wall = wall) -> float:
            ratio = published.felt(omega, wall.environment, device=flexible)
            ratio = ratio / published.felt(omega, wall.environment)
            return float(np.maximum(ratio, 1 / ratio).max()) - 1

        fraction = changed(published.omega())
        at_ten = changed(_AT)
        width = relative_width(wall, published.period)
        change[wall.name] = fraction
        told.append(f"{fraction:.1%} ({wall.name}, {width:.1%} wide)")
        most_at_ten = max(most_at_ten, at_ten)
        cases += [fraction < width, at_ten < width]
    most = max(change.values())
    return evidence(cases, told=", ".join(told), at_ten=most_at_ten, most=most, change=change)
