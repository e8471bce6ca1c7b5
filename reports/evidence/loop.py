"""A device, a hand and a sampled wall in time: exact between samples, by the matrix exponential.

The computer samples the position, works out the wall's force from it and from its backward
difference (filtered where there is a filter), and holds that force for a sample, later by a delay.
Nothing here knows the frequency domain, but for the choice of the worst hand.

The page says how often verdicts are right. A coupling with a rigid wall behind it is a wall of the
coupling's stiffness and damping: Eq. 6 is a spring and a backward difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import nnls
from scipy.signal import butter, tf2ss

from percept.haptics import Coupling, Environment, required_damping
from percept.haptics.loop import HOLDS, Hold
from percept.haptics.rendering import passivity_damping
from percept.haptics.velocity import VelocityFilter

Array: TypeAlias = NDArray[np.float64]

# In s.
PERIOD = 1e-3
# Aliases to either side of a frequency whose reactance the worst hand gets right: those beyond
# carry 3 % of the weight at most.
ALIASES = 8
# A device this near to the damping that it needs is left out, for those aliases.
TOO_NEAR = 0.05
# Larger factors of growth per sample count as growth; eigenvalues of 20 states are off by less.
GROWS = 1 + 1e-9
PAGE = """# Verdicts on sampled walls, in time

A device with a hand renders a wall directly, some walls with a delay and some with a filtered
velocity. Motion is exact between samples, by the matrix exponential. Whether a hand makes it grow
is read off the eigenvalues of one sample's step. All scenes are simulated. The device's damping is
0.2 to 5 times what Colgate and Schenkel's criterion asks for, {near:.0%} about it left out.

| called | scenes | some hand makes it grow |
|---|---|---|
| unstable | {unstable} | {grown} |
| stable | {stable} | {grown_though_stable} |

Each scene meets the hands that its worst frequency suggests and {random} random ones.
The paper's model (averaging hold, Eq. 8, with Tustin's method) gives another verdict in
{average_wrong} of {scenes} scenes: {average_called_stable} that grow it calls passive, and
{average_called_unstable} that never grow it calls active.

## Couplings with a rigid wall behind them

{couplings} random couplings (Eq. 6), some with a delay, hold a rigid wall. Equation 10 asks for
stability with every wall. Its model of the loop is not that of the motion: Tustin's method
discretizes the device, and forces that alias are left out. The device's damping is 0.2 to 5 times
what Eq. 10 asks for under Eq. 8.

| called stable by | couplings | some hand makes them grow |
|---|---|---|
{coupling_rows}

"""
RANDOM_HANDS = 10


@cache
def polynomials(velocity_filter: VelocityFilter) -> tuple[Array, Array]:
    """Return numerator and denominator of a filter in z, by scipy."""
    return butter(velocity_filter.order, velocity_filter.cutoff, fs=2 * np.pi / PERIOD)


@dataclass(frozen=True)
class Hand:
    """A passive hand that loses nothing: a mass, a spring to the ground, and carried masses."""

    mass: float = 0.0
    stiffness: float = 0.0
    carried: tuple[tuple[float, float], ...] = ()  # kg and N/m of each


@dataclass(frozen=True)
class SampledWall:
    """A device of a mass and a damping, and the wall it renders through its loop."""

    mass: float
    damping: float
    wall: Environment
    delay: float = 0.0

    @property
    def needed(self) -> tuple[float, float]:
        """Damping needed by Colgate and Schenkel, and in the paper's model, N·s/m."""
        needed = passivity_damping(self.wall, PERIOD, delay=self.delay)
        return float(needed.colgate), float(needed.paper)

    def growth(self, hand: Hand, loss: float = 0.0) -> float:
        """Largest factor by which a motion grows in a sample; `loss` is the hand's damping."""
        return float(np.abs(np.linalg.eigvals(self.step(hand, loss))).max())

    def step(self, hand: Hand, loss: float = 0.0) -> Array:
        """Return what a sample makes of positions, velocities and all that is remembered."""
        moving = self._moving(hand, loss)
        size = len(moving) - 1
        whole = int(np.floor(self.delay))
        fraction = self.delay - whole
        first = expm(moving * fraction * PERIOD)
        last = expm(moving * (1 - fraction) * PERIOD)
        free = (last @ first)[:size, :size]
        # Up to the fraction the force before is still held.
        from_before = (last @ first)[:size, size] - last[:size, size]
        from_newer = last[:size, size]
        filter_a, filter_b, filter_c, filter_d = self._filter()
        states = len(filter_a)
        # Remembered: the last position, the filter's states, and forces from the newest on.
        forces = whole + 1
        total = size + 1 + states + forces
        k, b = float(self.wall.stiffness), float(self.wall.damping)
        step = np.zeros((total, total))
        velocity = np.zeros(total)
        velocity[0] = 1 / PERIOD
        velocity[size] = -1 / PERIOD
        force = -b * filter_d * velocity
        force[0] -= k
        force[size + 1 : size + 1 + states] = -b * filter_c
        step[:size, :size] = free
        ages = [force, *np.eye(total)[size + 1 + states :]]
        step[:size] += np.outer(from_newer, ages[whole])
        step[:size] += np.outer(from_before, ages[whole + 1])
        step[size, 0] = 1.0
        rows = slice(size + 1, size + 1 + states)
        step[rows] = np.outer(filter_b, velocity)
        step[rows, rows] += filter_a
        for age in range(forces):
            step[size + 1 + states + age] = ages[age]
        return step

    def _moving(self, hand: Hand, loss: float) -> Array:
        """Continuous dynamics of position, velocity and carried masses; the last column is u."""
        size = 2 + 2 * len(hand.carried)
        moving = np.zeros((size + 1, size + 1))
        mass = self.mass + hand.mass
        moving[0, 1] = 1.0
        moving[1, 0] = -hand.stiffness / mass
        moving[1, 1] = -(self.damping + loss) / mass
        moving[1, size] = 1 / mass
        for number, (carried, spring) in enumerate(hand.carried):
            x = 2 + 2 * number
            moving[x, x + 1] = 1.0
            moving[x + 1, 0] += spring / carried
            moving[x + 1, x] -= spring / carried
            moving[1, 0] -= spring / mass
            moving[1, x] += spring / mass
        return moving

    def _filter(self) -> tuple[Array, Array, Array, float]:
        velocity_filter = self.wall.velocity_filter
        if velocity_filter is None:
            return np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
        a, b, c, d = tf2ss(*polynomials(velocity_filter))
        return a, b[:, 0], c[0], float(d[0, 0])

    def loop(self, theta: float) -> complex:
        """W at an angle ωT: what the wall asks of the device, over all aliases alike."""
        z = np.exp(1j * theta)
        difference = 1 - 1 / z
        response: Array | float = 1.0
        velocity_filter = self.wall.velocity_filter
        if velocity_filter is not None:
            top, bottom = polynomials(velocity_filter)
            response = np.polyval(top, z) / np.polyval(bottom, z)
        whole = np.floor(self.delay)
        fraction = self.delay - whole
        late = z**-whole * ((1 - fraction) + fraction / z)
        h = self.wall.stiffness + self.wall.damping * response * difference / PERIOD
        return complex(h * late * PERIOD * difference / (4 * np.sin(theta / 2) ** 2))

    def asked(self, theta: float) -> float:
        """Damping that an angle ωT asks for: the disc that a fraction of a delay makes of W."""
        mean = self.loop(theta)
        fraction = self.delay % 1
        late = (1 - fraction) + fraction * np.exp(-1j * theta)
        spread = 2 * np.sqrt(fraction * (1 - fraction)) * np.sin(theta / 2) * abs(mean / late)
        return float((mean.real + np.hypot(mean.real, spread)) / 2)


def worst_hands(setup: SampledWall, theta: float) -> list[Hand]:
    """Hands whose reactance at ω and its aliases makes the loop swing at ωT = theta.

    The loop swings undamped where device and hand together have the impedance W at every alias;
    below zero frequency reactances have the other sign.
    """
    target = setup.loop(theta).imag
    turns = np.arange(-ALIASES, ALIASES + 1)
    signed = (theta + 2 * np.pi * turns) / PERIOD
    omega = np.abs(signed)
    wanted = np.sign(signed) * target - setup.mass * omega
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
                (spring / pole**2, spring)
                for pole, spring in zip(between, parts[2:], strict=True)
                if spring > 0
            )
            hands.append(Hand(parts[0], parts[1], carried))
    return hands


def random_hand(rng: np.random.Generator) -> Hand:
    """Any passive hand."""
    carried = tuple(tuple(10 ** rng.uniform([-3, 0], [0.5, 7])) for _ in range(rng.integers(0, 3)))
    return Hand(10 ** rng.uniform(-2, 1), 10 ** rng.uniform(-1, 6), carried)


def random_wall(rng: np.random.Generator) -> SampledWall:
    """Draw a device and a wall, some with a filter, some with a delay, whole or fractional."""
    velocity_filter = None
    if rng.random() < 0.4:
        velocity_filter = VelocityFilter(10 ** rng.uniform(2, 3.3), int(rng.integers(1, 4)))
    delay = float(rng.choice([0.0, 1.0, 2.0, 3.0, rng.uniform(0, 3)]))
    stiffness, damping = 10 ** rng.uniform([2, -1], [5, 2])
    wall = Environment(stiffness, damping, 0.0, velocity_filter)
    return SampledWall(10 ** rng.uniform(-2, 0.3), 1.0, wall, delay)


def with_damping(setup: SampledWall, factor: float) -> SampledWall:
    """Give the device a multiple of the damping that it needs."""
    return replace(setup, damping=factor * setup.needed[0])


@dataclass(frozen=True)
class Outcome:
    """What a scene's verdicts say, and what its motion does."""

    setup: SampledWall
    called_stable: bool
    average_called_stable: bool
    largest_growth: float


def outcome(rng: np.random.Generator) -> Outcome:
    """Draw a scene, and look for a hand that makes its motion grow."""
    setup = random_wall(rng)
    side = rng.choice([-1, 1])
    factor = np.exp(side * rng.uniform(np.log1p(TOO_NEAR), np.log(5)))
    setup = with_damping(setup, float(factor))
    colgate, paper = setup.needed
    hands = [random_hand(rng) for _ in range(RANDOM_HANDS)]
    hands += worst_hands(setup, worst_angle(setup))
    growth = max(setup.growth(hand) for hand in hands)
    return Outcome(setup, setup.damping > colgate, setup.damping > paper, growth)


@dataclass(frozen=True)
class CouplingOutcome:
    """What verdicts on a coupling say, and what its motion with a rigid wall does."""

    called_stable: dict[str, bool]  # By criterion
    grows: bool


def coupling_outcome(rng: np.random.Generator) -> CouplingOutcome:
    """Draw a coupling and a device, and look for a hand that makes the motion grow."""
    k_c, b_c = 10 ** rng.uniform([2, -1], [5, 2])
    delay = float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0, 3)]))
    factor = np.exp(rng.choice([-1, 1]) * rng.uniform(np.log1p(TOO_NEAR), np.log(5)))
    needed = {}
    for hold in HOLDS:
        asked = required_damping(Coupling(k_c, b_c), PERIOD, hold=Hold(hold, delay))
        needed[f"Eq. 10, {hold} hold"] = float(asked.damping)
    device = factor * needed["Eq. 10, average hold"]
    setup = SampledWall(10 ** rng.uniform(-2, 0.3), device, Environment(k_c, b_c), delay)
    needed["Colgate and Schenkel, the coupling as a wall"] = setup.needed[0]
    hands = [random_hand(rng) for _ in range(RANDOM_HANDS)]
    hands += worst_hands(setup, worst_angle(setup))
    growth = max(setup.growth(hand) for hand in hands)
    stable = {name: device > enough for name, enough in needed.items()}
    return CouplingOutcome(stable, growth > GROWS)


def coupling_rows(outcomes: list[CouplingOutcome]) -> str:
    """Count by criterion what was called stable, and what of it grows."""
    rows = []
    for name in outcomes[0].called_stable:
        stable = [one for one in outcomes if one.called_stable[name]]
        rows.append(f"| {name} | {len(stable)} | {sum(one.grows for one in stable)} |")
    return "\n".join(rows)


def worst_angle(setup: SampledWall) -> float:
    """Angle ωT at which the loop asks for most."""
    angles = np.concatenate([np.geomspace(0.01, 0.1, 10), np.linspace(0.1, np.pi, 120)])
    asked = [setup.asked(angle) for angle in angles]
    worst = float(angles[int(np.argmax(asked))])
    # Next to Nyquist aliases come in pairs that no hand tells apart.
    return np.pi if worst > 3.1 else worst


def page(scenes: int, walls: int) -> str:
    """Draw scenes and couplings; count what was called stable and unstable, and what grew."""
    rng = np.random.default_rng(2)
    outcomes = [outcome(rng) for _ in range(scenes)]
    couplings = [coupling_outcome(rng) for _ in range(walls)]
    unstable = [one for one in outcomes if not one.called_stable]
    stable = [one for one in outcomes if one.called_stable]
    grew = {id(one) for one in outcomes if one.largest_growth > GROWS}
    blind = [one for one in outcomes if one.average_called_stable and id(one) in grew]
    harsh = [one for one in outcomes if not one.average_called_stable and id(one) not in grew]
    return PAGE.format(
        near=TOO_NEAR,
        scenes=len(outcomes),
        unstable=len(unstable),
        grown=sum(id(one) in grew for one in unstable),
        stable=len(stable),
        grown_though_stable=sum(id(one) in grew for one in stable),
        random=RANDOM_HANDS,
        average_wrong=len(blind) + len(harsh),
        average_called_stable=len(blind),
        average_called_unstable=len(harsh),
        couplings=len(couplings),
        coupling_rows=coupling_rows(couplings),
    )
