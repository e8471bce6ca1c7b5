"""Verdicts at every omega against a fine grid: `python -m tests.boundary.throughout SCENES POINTS`."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from scipy import special

from percept.boundary.feels_real import search_grid, search_margins
from percept.boundary.users import Users, choose_integral, share_within
from percept.haptics import Coupling, Device, Environment
from percept.haptics.impedance import warp
from percept.haptics.perceived import DistancePlane, Point, shown_element
from percept.haptics.records import Display

LEVEL = 0.99


@dataclass(frozen=True)
class Scene:
    """A display, draws of its users, and the frequencies that are searched."""

    display: Display
    users: Users
    omega: np.ndarray


def random_scene(seed, *, draws):
    """A display near the edge of what its users feel: parameters over several decades."""
    rng = np.random.default_rng(seed)
    environment = Environment(10 ** rng.uniform(1, 4.5), 10 ** rng.uniform(-1, 2))
    device = Device(10 ** rng.uniform(-1, 0.5), 10 ** rng.uniform(-0.5, 1.5))
    coupling = None
    if rng.integers(2):
        coupling = Coupling(environment.stiffness * 10 ** rng.uniform(0.7, 2), 100.0)
    sd = 10 ** rng.uniform(-2, -0.3, 2)
    shift = rng.uniform(-1.5, 1.5, 2)[:, None] + rng.standard_normal((2, draws))
    mean = np.log([[environment.stiffness], [environment.damping]]) + sd[:, None] * shift
    spread = sd[:, None] * np.exp(0.2 * rng.standard_normal((2, draws)))
    users = Users(True, mean, spread, rng.uniform(-0.9, 0.9, draws))
    resonance = np.sqrt(environment.stiffness / device.mass)
    omega = search_grid(0.1, 100.0, np.array([resonance]), np.array([0.5 * sd[0]]))
    return Scene(Display(device, environment, 1e-3, coupling), users, omega)


def brute_force(scene, *, points):
    """The smallest margin of each draw: searched, and on a grid of so many points."""
    searched = search_margins(scene.display, scene.users, scene.omega, LEVEL).least
    grid = np.geomspace(scene.omega[0], scene.omega[-1], points)
    return searched, margins_on(scene, grid).min(axis=1)


def margins_on(scene, omega):
    """Margins (D, M) at frequencies, each share with all its digits."""
    display = scene.display
    grid = warp(omega, display.period)
    shown = shown_element(grid, display)
    plane = DistancePlane.of(grid, display.device, display.hold, display.environment.mass).flat()
    radius = plane.distance(Point(shown.stiffness, shown.damping))
    users = scene.users.column()
    margins = np.empty((scene.users.size, omega.size))
    for index, integral in enumerate(choose_integral(users, plane, radius)):
        at = np.array([index])
        shares = share_within(users, plane.select(at), radius[at], integral)
        margins[:, index] = special.ndtri(0.5 * (1.0 + LEVEL)) - np.abs(special.ndtri(shares[:, 0]))
    return margins


def main(scenes, points):
    """Count the draws on which search and grid differ."""
    draws = differing = near = 0
    for seed in range(scenes):
        mine, fine = brute_force(random_scene(seed, draws=40), points=points)
        wrong = (mine >= 0.0) != (fine >= 0.0)
        draws += wrong.size
        differing += int(wrong.sum())
        near += int((wrong & (np.minimum(np.abs(mine), np.abs(fine)) < 1e-6)).sum())
        if wrong.any():
            print(seed, "searched", mine[wrong], "grid", fine[wrong], flush=True)
    print(f"{scenes} scenes, {draws} draws: {differing} differ, {near} of them within 1e-6")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(float(sys.argv[2])))
