"""Random scenes to judge, some with a planted excursion; the departure at one ω in 50 digits.

`python -m tests.haptics.scenes COUNT POINTS` holds the verdicts of many scenes against a grid.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain

import mpmath as mp
import numpy as np
from scipy.optimize import brentq

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Mode,
    TabulatedDevice,
    device_impedance,
    magnitude_envelope,
    perceived_impedance,
)
from percept.haptics.containment import ON_LIMIT, Boxes, Departures, departures
from percept.haptics.loop import Hold, hold_of
from percept.haptics.records import Display
from percept.haptics.velocity import VelocityFilter

PERIOD, LOWER, UPPER = 1e-3, 0.1, 100.0
# Of ten scenes so many have a planted excursion; one more touches its limit.
_PLANTED = 6


@dataclass(frozen=True)
class Scene:
    """A display, its box of (k, b), and what was planted: "" for nothing, "excursion" or "tie"."""

    display: Display
    box: Boxes
    planted: str

    def judged(self) -> Departures:
        """Judge it."""
        return departures(self.display, self.box, LOWER, UPPER)

    def on_grid(self, omega: np.ndarray) -> np.ndarray:
        """Departures at frequencies, by the public functions."""
        one, (k, b) = self.display, limits_of(self.box)
        mass = one.environment.mass
        low, high = magnitude_envelope(
            omega, one.device, k, b, one.period, mass=mass, hold=one.hold
        )
        shown = np.abs(
            perceived_impedance(
                omega, one.device, one.environment, one.period, coupling=one.coupling, hold=one.hold
            )
        )
        with np.errstate(divide="ignore"):
            return np.maximum(np.log(shown / high), np.log(low / shown))

    def in_fifty_digits(self, omega: float) -> float:
        """Departure at one ω, from Eqs 5 to 13 as written."""
        with mp.workdps(50):
            w, period, own = mp.mpf(omega), mp.mpf(self.display.period), self.display.environment
            h = w * period / 2
            s = mp.mpc(0, 2 / period * mp.tan(h))
            hold = hold_of(self.display.hold)
            gain = mp.cos(h) if hold.kind == "average" else mp.sin(h) / h
            z_d, held = self._device(w, s), gain * mp.expj(-(1 + 2 * mp.mpf(hold.delay)) * h)
            inertia = mp.mpf(own.mass) * s
            own_filter = _filter_of(own.velocity_filter, h, period)
            z_e = inertia + own_filter * mp.mpf(own.damping) + mp.mpf(own.stiffness) / s
            if self.display.coupling is not None:
                coupling = self.display.coupling
                z_c = _filter_of(coupling.velocity_filter, h, period) * mp.mpf(coupling.damping)
                z_c += mp.mpf(coupling.stiffness) / s
                z_e = z_e * z_c / (z_e + z_c)
            shown = abs(z_d + held * z_e)
            k, b = ([mp.mpf(end) for end in pair] for pair in limits_of(self.box))
            # The (k, b) at which Z_h vanishes: its nearest point of the box is a clip, the farthest
            # a corner. The environment's mass is not adjusted: it counts with the device.
            zero = -z_d / held - inertia
            b_at, k_at = zero.real, -zero.imag * s.imag

            def seen(k: mp.mpf, b: mp.mpf) -> mp.mpf:
                return abs(z_d + held * (inertia + b + k / s))

            high = max(seen(one, other) for one in k for other in b)
            low = seen(min(max(k_at, k[0]), k[1]), min(max(b_at, b[0]), b[1]))
            return float(max(mp.log(shown / high), mp.log(low / shown) if low else -mp.inf))

    def _device(self, w: mp.mpf, s: mp.mpc) -> mp.mpc:
        device = self.display.device
        if isinstance(device, TabulatedDevice):
            row = int(
                np.clip(
                    np.searchsorted(device.omega, float(w), "right") - 1, 0, device.omega.size - 2
                )
            )
            start, end = (mp.mpf(device.omega[i]) for i in (row, row + 1))
            first, last = (mp.mpmathify(complex(device.impedance[i])) for i in (row, row + 1))
            return first + (last - first) * (w - start) / (end - start)
        total = mp.mpf(device.damping) + mp.mpf(device.mass) * s + mp.mpf(device.stiffness) / s
        for mode in device.modes:
            m, k, b = (mp.mpf(v) for v in (mode.mass, mode.stiffness, mode.damping))
            total += m * s * (b * s + k) / (m * s * s + b * s + k)
        return total


def limits_of(box: Boxes) -> tuple[tuple[float, float], ...]:
    """Limits of k and of b of a single box."""
    return tuple((float(low[0]), float(high[0])) for low, high in (box.stiffness, box.damping))


def box(k: tuple[float, float], b: tuple[float, float]) -> Boxes:
    """A single box."""
    return Boxes.of(k, b)


def scenes(
    count: int,
    seed: int,
    *,
    mass: bool = False,
    delay: bool = False,
    filtered: bool = False,
    sprung: bool = False,
) -> Iterator[Scene]:
    """Rigid, modal and tabulated devices in turn, all with a mass, delay or filter if asked for.

    A spring goes to rigid and modal ones alone.
    """
    rng = np.random.default_rng(seed)
    for i in range(count):
        display, limits = _random(rng, ("rigid", "modal", "table")[i % 3])
        if mass:
            display = _heavy(rng, display)
        if delay:
            samples = float(rng.integers(1, 5)) if i % 2 else rng.uniform(0.01, 6.0)
            display = replace(display, hold=Hold(str(display.hold), samples))
        if filtered:
            display = _filtered(rng, display)
        if sprung and isinstance(display.device, Device):
            spring = replace(display.device, stiffness=10 ** rng.uniform(0, 5))
            display = replace(display, device=spring)
        planted = ("excursion" if i % 10 < _PLANTED else "tie") if i % 10 <= _PLANTED else ""
        if planted:
            height = 10 ** rng.uniform(-9.3, -7.5) if planted == "excursion" else 0.0
            found = _planted(display, limits, height)
            limits, planted = (limits, "") if found is None else (found, planted)
        yield Scene(display, limits, planted)


def _random(rng: np.random.Generator, kind: str) -> tuple[Display, Boxes]:
    k, b = 10 ** rng.uniform(2, 5), 10 ** rng.uniform(-0.5, 2)
    rigid = 10 ** rng.uniform(-1.5, 0.7), 10 ** rng.uniform(-1, 1.5)

    def modes(least: float, count: int) -> tuple[Mode, ...]:
        lows, highs = (-3, 1, least), (0, 5, 1)
        return tuple(Mode(*(10 ** rng.uniform(lows, highs))) for _ in range(count))

    device: Device | TabulatedDevice = Device(*rigid)
    if kind == "modal":
        device = Device(*rigid, modes(-4, rng.integers(1, 4)))
    elif kind == "table":
        omega = np.unique([0.09, 101.0, *(10 ** rng.uniform(-1, 2, rng.integers(5, 200)))])
        smooth = device_impedance(omega, Device(*rigid, modes(-1, rng.integers(0, 3))), PERIOD)
        device = TabulatedDevice(omega, smooth * np.exp(rng.normal(0, 0.03, omega.size)))
    coupling = Coupling(10 ** rng.uniform(2.5, 5.3), 10 ** rng.uniform(-1, 2.5))
    hold = "true" if rng.random() < 0.3 else "average"
    off, half = rng.normal(0, 0.15, 2), 10 ** rng.uniform(-1.5, 0, 2)
    limits = box(
        (k * np.exp(off[0] - half[0]), k * np.exp(off[0] + half[0])),
        (b * np.exp(3 * (off[1] - half[1])), b * np.exp(3 * (off[1] + half[1]))),
    )
    return (
        Display(device, Environment(k, b), PERIOD, None if rng.random() < 0.35 else coupling, hold),
        limits,
    )


def heavy_tables(count: int, seed: int) -> Iterator[Scene]:
    """Environments with a mass, displayed by tabulated devices through couplings."""
    rng = np.random.default_rng(seed)
    while count:
        display, limits = _random(rng, "table")
        if display.coupling is not None:
            yield Scene(_heavy(rng, display), limits, "")
            count -= 1


def _heavy(rng: np.random.Generator, display: Display) -> Display:
    """Give the environment of a display a mass, 10 g to 10 kg."""
    environment = replace(display.environment, mass=10 ** rng.uniform(-2, 1))
    return replace(display, environment=environment)


def _filtered(rng: np.random.Generator, display: Display) -> Display:
    """Filter the velocity of the damper that joins the device."""
    velocity_filter = VelocityFilter(10 ** rng.uniform(1.5, 3.2), int(rng.integers(1, 4)))
    if display.coupling is None:
        environment = replace(display.environment, velocity_filter=velocity_filter)
        return replace(display, environment=environment)
    return replace(display, coupling=replace(display.coupling, velocity_filter=velocity_filter))


def _filter_of(velocity_filter: VelocityFilter | None, h: mp.mpf, period: mp.mpf) -> mp.mpc:
    """Butterworth's filter by its poles; 1 without one."""
    if velocity_filter is None:
        return mp.mpf(1)
    x = mp.tan(h) / mp.tan(mp.mpf(velocity_filter.cutoff) * period / 2)
    response = mp.mpf(1)
    for pole in range(velocity_filter.order):
        angle = mp.pi * (2 * pole + 1) / (2 * velocity_filter.order)
        response /= mp.mpc(mp.sin(angle), x - mp.cos(angle))
    return response


def _planted(display: Display, limits: Boxes, height: float) -> Boxes | None:
    """Widen or narrow a box until the largest departure is `height`; None if no width does it."""

    def scaled(factor: float) -> Boxes:
        middles = [np.sqrt(low * high) for low, high in (limits.stiffness, limits.damping)]
        pairs = zip(middles, (limits.stiffness, limits.damping), strict=True)
        return Boxes.of(*([at * (end / at) ** factor for end in pair] for at, pair in pairs))

    def excess(log_factor: float) -> float:
        found = departures(display, scaled(np.exp(log_factor)), LOWER, UPPER)
        return float(found.largest[0]) - height

    low, high = -7.0, 3.4
    if excess(low) <= 0 or excess(high) > 0:
        return None
    return scaled(np.exp(brentq(excess, low, high, xtol=1e-14, rtol=1e-14)))


def contradiction(scene: Scene, omega: np.ndarray) -> tuple[str, float]:
    """Say what contradicts a verdict, "" for nothing, and the fraction of a grid outside."""
    found, seen = scene.judged(), scene.on_grid(omega)
    verdict, most = found.verdict(), float(seen.max())
    wrong = ""
    if most > found.bound[0] + 1e-12:
        wrong = "beyond the bound"
    elif (verdict == "inside" and most > 0) or (verdict == "marginal" and most > 2 * ON_LIMIT):
        wrong = f"{verdict}, yet a point departs by {most:.3g}"
    elif verdict == "outside" and not scene.in_fifty_digits(float(found.omega[0])) > 0:
        wrong = "the witness is inside"
    elif scene.planted == "tie" and verdict != "marginal":
        wrong = f"a tie is {verdict}"
    return wrong, float((seen > 0).mean()) if verdict == "outside" else np.nan


def _held_against_a_grid(count: int, points: int) -> None:
    omega = np.geomspace(LOWER, UPPER, points)
    omega[[0, -1]] = LOWER, UPPER
    told: Counter[str] = Counter()
    heavy = count // 2
    for i, scene in enumerate(chain(scenes(count - heavy, 7), scenes(heavy, 8, mass=True))):
        wrong, outside = contradiction(scene, omega)
        told[scene.planted or "as drawn"] += 1
        told["narrower than 1e-4"] += outside < 1e-4
        told["outside, unseen by the grid"] += outside == 0
        if wrong:
            told["contradicted"] += 1
            print(i, wrong)
    print(dict(told))


if __name__ == "__main__":
    _held_against_a_grid(int(sys.argv[1]), int(float(sys.argv[2])))
