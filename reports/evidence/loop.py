"""A device, a hand and a sampled force in time: exact between samples, by the matrix exponential.

The computer samples the position, works out the force H(z) from it and holds it for a sample, later
by a delay. Nothing here knows the frequency domain, but for the choice of the worst hands. The page
says how often what is called renderable grows, and how near to its limit a loop does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import nnls
from scipy.signal import butter, tf2ss

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    Mode,
    VelocityFilter,
    can_render,
    required_damping,
)
from percept.haptics.rendering import Rendering
from reports.page import Page

Array = NDArray[np.float64]
#: Numerator and denominator in powers of z⁻¹.
Fraction: TypeAlias = tuple[Array, Array]

# In s.
PERIOD = 1e-3
# Aliases to either side of a frequency whose reactance the worst hand gets right.
ALIASES = 8
# Larger factors of growth per sample count as growth; eigenvalues of 20 states are off by less.
GROWS = 1 + 1e-9
BELOW = 0.999
ABOVE = 1.05
#: Reactance zeros of the hands that are tuned to Nyquist and its aliases.
ZEROS = (8, 10)
RANDOM_HANDS = 60
_INTRODUCTION = """\
A device with a hand renders an environment directly or through a coupling, or a coupling with a
rigid wall behind it. Devices have up to two flexible modes; some environments have a mass, some
loops a delay of whole samples or of a fraction, some a velocity filter. Motion is exact between
samples, by the matrix exponential. Whether a hand makes it grow is read off the eigenvalues of one
sample's step. All loops are simulated, and scaled to a part of the limit of `can_render`."""


@dataclass(frozen=True)
class Hand:
    """A passive hand: a mass, a spring and a damper to the ground, and carried masses."""

    mass: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    carried: tuple[Mode, ...] = ()


def transfer(motion: Motion) -> Fraction:
    """Return numerator and denominator of H in powers of z⁻¹, N/m."""
    e = motion.environment
    c = motion.coupling
    velocity_filter = motion.loop.velocity_filter
    parts = []
    if e is not None:
        environment_filter = velocity_filter if c is None else None
        parts.append(
            _element(float(e.stiffness), float(e.damping), float(e.mass), environment_filter)
        )
    if c is not None:
        parts.append(_element(float(c.stiffness), float(c.damping), 0.0, velocity_filter))
    if len(parts) == 1:
        return parts[0]
    top_e, bottom_e = parts[0]
    top_c, bottom_c = parts[1]
    total = _added(np.convolve(top_e, bottom_c), np.convolve(top_c, bottom_e))
    return np.convolve(top_e, top_c), total


def _element(k: float, b: float, m: float, velocity_filter: VelocityFilter | None) -> Fraction:
    """Return k + b·F·δ + m·δ² as a fraction in z⁻¹."""
    difference = np.array([1.0, -1.0]) / PERIOD
    top = np.ones(1)
    bottom = np.ones(1)
    if velocity_filter is not None:
        top, bottom = butter(velocity_filter.order, velocity_filter.cutoff, fs=2 * np.pi / PERIOD)
    spring_and_mass = _added(np.array([k]), m * np.convolve(difference, difference))
    both = np.convolve(spring_and_mass, bottom)
    return _added(both, b * np.convolve(top, difference)), bottom


def _added(first: Array, second: Array) -> Array:
    size = max(len(first), len(second))
    return np.pad(first, (0, size - len(first))) + np.pad(second, (0, size - len(second)))


@dataclass(frozen=True)
class Motion:
    """A loop that renders an environment directly, or through a coupling (None: rigid wall)."""

    loop: Loop
    environment: Environment | None
    coupling: Coupling | None = None

    @property
    def device(self) -> Device:
        """The device, rigid or with modes."""
        assert isinstance(self.loop.device, Device)
        return self.loop.device

    @property
    def judged(self) -> Rendering:
        """Return what percept says of it."""
        return can_render(self.loop, self.environment, coupling=self.coupling)

    def at(self, load: float) -> Motion:
        """Return the same with its force scaled: at a load of 1 it is at its limit."""
        times = load * self.judged.margin
        environment = self.environment
        if environment is not None:
            environment = replace(
                environment,
                stiffness=times * environment.stiffness,
                damping=times * environment.damping,
                mass=times * environment.mass,
            )
        coupling = self.coupling
        if coupling is not None:
            coupling = replace(
                coupling, stiffness=times * coupling.stiffness, damping=times * coupling.damping
            )
        return replace(self, environment=environment, coupling=coupling)

    def growth(self, hand: Hand) -> float:
        """Largest factor by which a motion grows in a sample."""
        return float(np.abs(np.linalg.eigvals(self.step(hand))).max())

    def step(self, hand: Hand) -> Array:
        """Say what a sample makes of positions, velocities, and all that the computer remembers."""
        moving = self._moving(hand)
        size = len(moving) - 1
        whole = int(np.floor(self.loop.delay))
        fraction = self.loop.delay - whole
        first = expm(moving * fraction * PERIOD)
        last = expm(moving * (1 - fraction) * PERIOD)
        free = (last @ first)[:size, :size]
        # Up to the fraction the force before is still held.
        from_before = (last @ first)[:size, size] - last[:size, size]
        from_newer = last[:size, size]
        top, bottom = transfer(self)
        pad = max(len(top), len(bottom))
        a, b, c, d = tf2ss(np.pad(top, (0, pad - len(top))), np.pad(bottom, (0, pad - len(bottom))))
        # Remembered: the states of H, and forces from the newest on.
        states = len(a)
        forces = whole + 1
        total = size + states + forces
        step = np.zeros((total, total))
        force = np.zeros(total)
        force[0] = -d[0, 0]
        force[size : size + states] = -c[0]
        step[:size, :size] = free
        ages = [force, *np.eye(total)[size + states :]]
        step[:size] += np.outer(from_newer, ages[whole])
        step[:size] += np.outer(from_before, ages[whole + 1])
        rows = slice(size, size + states)
        step[rows, 0] = b[:, 0]
        step[rows, rows] += a
        for age in range(forces):
            step[size + states + age] = ages[age]
        return step

    def _moving(self, hand: Hand) -> Array:
        """Continuous dynamics of position, velocity and carried masses; the last column is u."""
        carried = (*self.device.modes, *hand.carried)
        size = 2 + 2 * len(carried)
        moving = np.zeros((size + 1, size + 1))
        mass = self.device.mass + hand.mass
        moving[0, 1] = 1.0
        moving[1, 0] = -(hand.stiffness + self.device.stiffness) / mass
        moving[1, 1] = -(self.device.damping + hand.damping) / mass
        moving[1, size] = 1 / mass
        for number, mode in enumerate(carried):
            x = 2 + 2 * number
            moving[x, x + 1] = 1.0
            for place, gain in ((0, mode.stiffness), (1, mode.damping)):
                moving[x + 1, place] += gain / mode.mass
                moving[x + 1, x + place] -= gain / mode.mass
                moving[1, place] -= gain / mass
                moving[1, x + place] += gain / mass
        return moving


def device_impedance_in_time(device: Device, omega: Array) -> NDArray[np.complex128]:
    """Return Z_d(jω) in continuous time."""
    s = 1j * omega
    total = device.mass * s + device.damping + device.stiffness / s
    for mode in device.modes:
        joint = mode.damping * s + mode.stiffness
        total = total + mode.mass * s * joint / (mode.mass * s**2 + joint)
    return np.asarray(total)


def worst_hands(motion: Motion) -> list[Hand]:
    """Return hands whose reactance makes the loop swing at the ω that binds.

    At every alias hand and device together have an impedance in proportion to what the device
    dissipates there, with the phase of what the loop asks for.
    """
    theta = motion.judged.binding_omega * PERIOD
    # Next to Nyquist aliases come in pairs that no hand tells apart.
    theta = np.pi if theta > 3.1 else max(theta, 0.02)
    z = np.exp(1j * theta)
    top, bottom = transfer(motion)
    back = z ** -np.arange(max(len(top), len(bottom)))
    h = top @ back[: len(top)] / (bottom @ back[: len(bottom)])
    asked = PERIOD * (1 - 1 / z) * h * z**-motion.loop.delay / (4 * np.sin(theta / 2) ** 2)
    turns = np.arange(-ALIASES, ALIASES + 1)
    signed = (theta + 2 * np.pi * turns) / PERIOD
    omega = np.abs(signed)
    shown = device_impedance_in_time(motion.device, omega)
    tilt = np.tan(np.clip(np.angle(asked), -1.5, 1.5))
    wanted = np.sign(signed) * shown.real * tilt - shown.imag
    # At Nyquist aliases fall together in pairs.
    omega, order = np.unique(omega.round(6), return_index=True)
    wanted = wanted[order]
    hands = []
    for count in (0, 1, 2, 3, 4, 6, 8, 12, 16):
        if count >= len(omega):
            break
        for share in (0.1, 0.5, 0.9):
            between = omega[:count] + share * (omega[1 : count + 1] - omega[:count])
            used = slice(0, count + 1)
            columns = [omega[used], -1 / omega[used]]
            columns += [omega[used] / (pole**2 - omega[used] ** 2) for pole in between]
            table = np.array(columns).T
            scale = np.abs(table).max(axis=0)
            weight = 1 / omega[used]
            parts, _ = nnls(table / scale * weight[:, None], wanted[used] * weight)
            parts = parts / scale
            carried = tuple(
                Mode(spring / pole**2, spring, 0.0)
                for pole, spring in zip(between, parts[2:], strict=True)
                if spring > 0
            )
            hands.append(Hand(parts[0], parts[1], 0.0, carried))
    return hands


def resonant_hand(device: Device, count: int) -> Hand:
    """Return a hand that leaves device and hand together no reactance at (2j + 1)π/T, j < count.

    The reactance is that of a mass times Π(s² + z²)/(s·Π(s² + p²)), its poles between its zeros:
    by Foster a mass, a spring to the ground and carried masses.
    """
    zeros = (2 * np.arange(count) + 1) * np.pi / PERIOD
    poles = 2 * np.arange(1, count) * np.pi / PERIOD
    mass = float(device.mass)  # What is left at the handle is the device's own
    carried = []
    for pole in poles:
        others = poles[poles != pole]
        residue = -mass * np.prod(zeros**2 - pole**2) / (pole**2 * np.prod(others**2 - pole**2))
        # m·s·k/(m·s² + k) is k·s/(s² + k/m).
        carried.append(Mode(residue / pole**2, residue, 0.0))
    ground = mass * np.prod(zeros**2) / np.prod(poles**2)
    return Hand(0.0, float(ground), 0.0, tuple(carried))


def random_hand(rng: np.random.Generator) -> Hand:
    """Draw any passive hand."""
    carried = []
    for _ in range(rng.integers(0, 3)):
        damping = float(10 ** rng.uniform(-3, 1)) if rng.random() < 0.5 else 0.0
        mass, stiffness = 10 ** rng.uniform([-3, 0], [0.5, 7])
        carried.append(Mode(mass, stiffness, damping))
    damping = float(10 ** rng.uniform(-3, 0)) if rng.random() < 0.5 else 0.0
    mass, stiffness = 10 ** rng.uniform([-2, -1], [1, 6])
    return Hand(mass, stiffness, damping, tuple(carried))


def random_motion(rng: np.random.Generator) -> Motion:
    """Draw a device, with modes or without, and what it renders, in any loop."""
    modes = []
    for _ in range(rng.integers(0, 3)):
        m, k, b = 10 ** rng.uniform([-2, 2, -1], [0, 7, 1.5])
        modes.append(Mode(m, k, b))
    device = Device(10 ** rng.uniform(-2, 0.3), 10 ** rng.uniform(-1, 1.5), tuple(modes))
    velocity_filter = None
    if rng.random() < 0.4:
        velocity_filter = VelocityFilter(10 ** rng.uniform(2, 3.3), int(rng.integers(1, 3)))
    delay = float(rng.choice([0.0, 0.0, 1.0, 2.0, 3.0, rng.uniform(0, 3)]))
    k, b = 10 ** rng.uniform([2, -1], [5, 2])
    mass = float(10 ** rng.uniform(-3, 0)) if rng.random() < 0.3 else 0.0
    k_c, b_c = 10 ** rng.uniform([2, -1], [5, 2])
    coupling = Coupling(k_c, b_c)
    loop = Loop(device, PERIOD, "true", velocity_filter, delay)
    way = rng.integers(0, 3)
    if way == 0:
        return Motion(loop, Environment(k, b, mass))
    if way == 1:
        return Motion(loop, None, coupling)
    return Motion(loop, Environment(k, b, mass), coupling)


def plain(motion: Motion) -> Motion:
    """Return it without modes, environment's mass, filter and delay: its limit is closed."""
    environment = motion.environment
    if environment is not None:
        environment = replace(environment, mass=0.0)
    rigid = Device(motion.device.mass, motion.device.damping)
    return Motion(Loop(rigid, PERIOD), environment, motion.coupling)


@dataclass(frozen=True)
class Outcome:
    """Whether some hand makes a loop grow below and above its limit."""

    below: bool  # At .999 of the limit, any of the random and the worst hands
    above: bool  # At 1.05 of it, any of the worst
    eq10_met: bool  # By the damping that Eq. 10 asks for, at 1.05 of the limit


def outcome(rng: np.random.Generator, hands: int) -> Outcome:
    """Draw a loop, and look for hands that make its motion grow."""
    drawn = random_motion(rng)
    inside = drawn.at(BELOW)
    tried = [random_hand(rng) for _ in range(hands)]
    below = max(inside.growth(hand) for hand in tried + worst_hands(inside)) > GROWS
    beyond = drawn.at(ABOVE)
    above = max(beyond.growth(hand) for hand in worst_hands(beyond)) > GROWS
    eq10_met = False
    if beyond.coupling is not None:
        needed = required_damping(replace(beyond.loop, hold="average"), beyond.coupling)
        eq10_met = bool(beyond.device.damping >= needed.damping)
    return Outcome(below, above, eq10_met)


def grows_beyond(rng: np.random.Generator) -> bool:
    """Draw a plain loop; say whether a resonant hand makes its motion grow above the limit."""
    beyond = plain(random_motion(rng)).at(ABOVE)
    hands = [resonant_hand(beyond.device, count) for count in ZEROS]
    return max(beyond.growth(hand) for hand in hands) > 1


def page(out: Path, *, scenes: int = 500, couplings: int = 200) -> Page:
    """Draw loops, and as many plain ones as `couplings`; count what grows.

    Parameters
    ----------
    out : Path
        Folder of the page.
    scenes, couplings : int
        Loops of any kind, and plain ones.

    Returns
    -------
    Page
    """
    rng = np.random.default_rng(2)
    outcomes = [outcome(rng, RANDOM_HANDS) for _ in range(scenes)]
    below = sum(one.below for one in outcomes)
    above = sum(one.above for one in outcomes)
    resonant = sum(grows_beyond(rng) for _ in range(couplings))
    suggested = "those its worst frequency suggests"
    tuned = "of eight or ten reactance zeros at (2j + 1)π/T"
    page = Page("Loops in time", _INTRODUCTION, right=below == 0 and resonant == couplings)
    page.table(
        ["part of the limit", "loops", "hands", "some hand makes the motion grow"],
        [
            [BELOW, scenes, f"{RANDOM_HANDS} random ones, and {suggested}", below],
            [ABOVE, scenes, suggested, above],
            [f"{ABOVE}, without modes, mass, filter and delay", couplings, tuned, resonant],
        ],
    )
    eq10 = [one.above for one in outcomes if one.eq10_met]
    page.add(
        f"At {ABOVE} of the limit, {len(eq10)} of the couplings meet the paper's Eq. 10 for all"
        f" that: it leaves out that sampled forces alias. The motion of {sum(eq10)} of them grows."
    )
    return page
