"""Verdicts at every omega against a fine grid.

The grid takes its shares by the same integral as the search, at every point. How many nodes a point
needs is asked at the ends of short pieces: neighbours need nearly the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.boundary.feels_real import search_grid, search_scores
from percept.boundary.users import DiscIntegral, Users, choose_integral, share_within
from percept.haptics import Coupling, Device, Environment, Loop
from percept.haptics.perceived import Display, shown_element
from percept.haptics.plane import DistancePlane, Point
from reports.command import say

Array: TypeAlias = NDArray[np.float64]

LEVEL = 0.99
EDGE = -special.ndtri(0.5 * (1.0 - LEVEL))
#: Decades of a piece of the grid, which has one integral.
PIECE = 0.0075
#: Draws that show how many nodes a piece needs.
TRIED = 8
#: Accuracy of the shares that are looked at first, and below which margin they are taken again.
FIRST_ACCURACY = 1e-4
UNSURE_BELOW = 0.1
#: A margin in SDs below which a draw counts as too near.
TOO_NEAR = 1e-6
PAGE = """# Verdicts throughout the range

A draw holds a display where the smallest margin over the range is not negative. The search that
verdicts use is compared with a grid of {points:,} frequencies, in {scenes} scenes of 40 draws.

| draws | judged differently | of these too near to tell |
|---|---|---|
| {draws:,} | {differing} | {too_near} |

A margin is too near below 1e-6 SDs; verdicts count such draws into their stated error.

"""


@dataclass(frozen=True)
class Scene:
    """A display, draws of its users, and the frequencies that are searched."""

    display: Display
    users: Users
    omega: Array


def random_scene(seed: int, *, draws: int) -> Scene:
    """Draw a display near the edge of what its users feel: parameters over several decades."""
    rng = np.random.default_rng(seed)
    environment = Environment(10 ** rng.uniform(1, 4.5), 10 ** rng.uniform(-1, 2))
    device = Device(10 ** rng.uniform(-1, 0.5), 10 ** rng.uniform(-0.5, 1.5))
    coupling = None
    if rng.integers(2):
        coupling = Coupling(environment.stiffness * 10 ** rng.uniform(0.7, 2), 100.0)
    sd = 10 ** rng.uniform(-2, -0.3, 2)
    shift = rng.uniform(-1.5, 1.5, 2)[:, None] + rng.standard_normal((2, draws))
    shown = np.array([[environment.stiffness], [environment.damping]], dtype=float)
    mean = np.log(shown) + sd[:, None] * shift
    spread = sd[:, None] * np.exp(0.2 * rng.standard_normal((2, draws)))
    users = Users(True, mean, spread, rng.uniform(-0.9, 0.9, draws))
    resonance = np.sqrt(environment.stiffness / device.mass)
    omega = search_grid(0.1, 100.0, np.array([resonance]), np.array([0.5 * sd[0]]))
    return Scene(Display(Loop(device, 1e-3), environment, coupling), users, omega)


def shown_at(display: Display, omega: Array) -> tuple[DistancePlane, Array]:
    """Return the plane of abs(Z_h) at frequencies, and the abs(Z_h) that is displayed there."""
    grid = display.loop.at(omega)
    plane = DistancePlane.of(grid, display.environment.mass).flat()
    shown = shown_element(grid, display)
    return plane, plane.distance(Point(shown.stiffness, shown.damping))


def richest(integrals: Sequence[DiscIntegral]) -> DiscIntegral:
    """Return the one with more nodes, of the integrals at both ends of a piece."""
    return max(integrals, key=lambda integral: integral.nodes)


def integrals_of(scene: Scene, ends: Array, accuracy: float) -> list[DiscIntegral]:
    """Return the integral of every piece, by those of its ends."""
    few = scene.users.select(slice(None, None, max(1, scene.users.size // TRIED))).column()
    plane, radius = shown_at(scene.display, ends)
    at_ends = choose_integral(few, plane, radius, accuracy)
    return [richest(pair) for pair in itertools.pairwise(at_ends)]


def margins_of(share: Array) -> Array:
    """Return margins in SDs from shares of users."""
    return EDGE - np.abs(special.ndtri(np.clip(share, 0.0, 1.0)))


def grid_margins(scene: Scene, *, points: int) -> Array:
    """Return the smallest margin of each draw on a grid of so many points, a piece at a time.

    Of a draw that the display lies outside of, some negative margin.
    """
    grid = np.geomspace(scene.omega[0], scene.omega[-1], points)
    per_decade = points / np.log10(grid[-1] / grid[0])
    length = max(1, round(PIECE * per_decade))
    starts = np.arange(0, points, length)
    ends = grid[np.append(starts, points - 1)]
    rough = integrals_of(scene, ends, FIRST_ACCURACY)
    exact = integrals_of(scene, ends, 1e-7)
    least = np.full(scene.users.size, np.inf)
    lowest = np.zeros(scene.users.size, dtype=np.intp)
    for number, start in enumerate(starts):
        (inside,) = np.nonzero(least >= 0.0)
        users = scene.users.select(inside)
        omega = grid[start : start + length]
        plane, radius = shown_at(scene.display, omega)
        margins = margins_of(share_within(users.column(), plane, radius, rough[number]))
        # Digits matter where a margin may decide.
        draw, column = np.nonzero(np.abs(margins) < UNSURE_BELOW)
        if draw.size:
            there = plane.select(column)
            share = share_within(users.select(draw), there, radius[column], exact[number])
            margins[draw, column] = margins_of(share)
        here = margins.argmin(axis=1)
        lower = margins.min(axis=1) < least[inside]
        least[inside[lower]] = margins.min(axis=1)[lower]
        lowest[inside[lower]] = start + here[lower]
    for index in np.flatnonzero(least >= UNSURE_BELOW):
        point = lowest[[index]]
        plane, radius = shown_at(scene.display, grid[point])
        share = share_within(
            scene.users.select(np.array([index])), plane, radius, exact[point[0] // length]
        )
        least[index] = margins_of(share)[0]
    return least


def brute_force(scene: Scene, *, points: int) -> tuple[Array, Array]:
    """Return the smallest margin of each draw: searched, and on a grid of so many points."""
    found = search_scores(scene.display, scene.users, scene.omega, LEVEL)
    searched = EDGE - found.largest
    return searched, grid_margins(scene, points=points)


@dataclass
class Tally:
    """Draws that were compared, and those that search and grid judge differently."""

    draws: int = 0
    differing: int = 0
    too_near: int = 0  # Of those that differ

    def add(self, searched: Array, fine: Array) -> None:
        """Count the draws of a scene, by their smallest margins."""
        wrong = (searched >= 0.0) != (fine >= 0.0)
        nearest = np.minimum(np.abs(searched), np.abs(fine))
        self.draws += wrong.size
        self.differing += int(wrong.sum())
        self.too_near += int((wrong & (nearest < TOO_NEAR)).sum())


def page(scenes: int, points: int) -> tuple[bool, str]:
    """Compare search and grid in many scenes; say whether they differ, and write the page."""
    tally = Tally()
    for seed in range(scenes):
        tally.add(*brute_force(random_scene(seed, draws=40), points=points))
        say(f"{seed + 1} of {scenes} scenes {tally}")
    differ = tally.differing > tally.too_near
    return differ, PAGE.format(points=points, scenes=scenes, **vars(tally))
