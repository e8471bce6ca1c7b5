"""Verdicts on displays: against a fine grid of frequencies, known cases, and today's easier
rule."""

import dataclasses

import numpy as np
import pytest

from percept.boundary.feels_real import (
    CENTRALS,
    Evidence,
    feels_real,
    judge,
    search_grid,
    search_scores,
)
from percept.boundary.shares import Users, score_of
from percept.haptics import Coupling, Device, Environment, Loop
from percept.haptics.perceived import Display

LEVEL, DECISION = 0.99, 0.95
EDGES = np.unique([score_of(central) for central in (*CENTRALS, LEVEL)])
WALL = Environment(stiffness=500.0, damping=2.0)
DISPLAY = Display(Loop(Device(mass=0.5, damping=5.0), 1e-3), WALL)
OMEGA = search_grid(0.1, 100.0, np.array([np.sqrt(500.0 / 0.5)]), 0.02)


def populations(bias, sd, *, count=2_000, spread=0.0, seed=1):
    """Lognormal users `bias` SDs above the wall; means scatter by `spread` SDs over the draws."""
    rng = np.random.default_rng(seed)
    shift = bias + spread * rng.standard_normal((2, count))
    mean = np.log([[500.0], [2.0]]) + sd * shift
    return Users(True, mean, np.full((2, count), sd), np.zeros(count))


def random_scene(seed, *, draws):
    """A display near the edge of what its users feel, parameters over several decades."""
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
    omega = search_grid(0.1, 100.0, np.array([resonance]), 0.5 * sd[0])
    return Display(Loop(device, 1e-3), environment, coupling), users, omega


@pytest.mark.parametrize("seed", range(6))
def test_against_a_fine_grid(seed):
    display, users, omega = random_scene(seed, draws=12)
    dense = np.union1d(omega, np.geomspace(0.1, 100.0, 1_500))
    mine = search_scores(display, users, omega, EDGES).largest
    fine = search_scores(display, users, dense, EDGES).largest
    for edge in EDGES:
        differing = (mine <= edge) != (fine <= edge)
        assert np.all(np.abs(fine[differing] - edge) < 1e-6)


def test_the_least_probable_omega_is_found_between_frequencies():
    # Nothing of the even grid stands at this narrow resonance.
    narrow = dataclasses.replace(DISPLAY, loop=Loop(Device(mass=0.5, damping=0.2), 1e-3))
    even = np.geomspace(0.12, 100.0, 37)
    users = populations(1.0, 0.05, count=200, spread=1.0)
    found = feels_real(narrow, users, even, central=LEVEL, decision=DECISION)
    dense = np.geomspace(25.0, 40.0, 400)
    held = (search_scores(narrow, users, dense, EDGES).at_omega <= score_of(LEVEL)).mean(axis=0)
    assert found.lowest == pytest.approx(held.min(), abs=0.02)
    assert found.lowest_omega == pytest.approx(dense[held.argmin()], rel=0.01)
    on_grid = search_scores(narrow, users, even, EDGES).at_omega <= score_of(LEVEL)
    assert found.lowest < on_grid.mean(axis=0).min() - 0.1


SOFT = Coupling(stiffness=250.0, damping=2.0)


@pytest.mark.parametrize(
    ("bias", "spread", "coupling", "outcome"),
    [
        (0.0, 0.0, None, "feels real"),
        (4.0, 0.0, None, "does not"),
        # Three SDs off better data of the same users settle it; worse ones do not.
        (3.0, 0.05, None, "does not"),
        (3.0, 2.0, None, "too little data"),
        # A soft coupling shows another wall.
        (0.0, 0.0, SOFT, "does not"),
    ],
)
def test_known_cases(bias, spread, coupling, outcome):
    display = Display(DISPLAY.loop, WALL, coupling)
    users = populations(bias, 0.2, spread=spread)
    evidence = feels_real(display, users, OMEGA, central=LEVEL, decision=DECISION)
    assert judge(evidence.probability, DECISION) == outcome


def test_draws_are_added_only_while_the_error_straddles_a_threshold():
    clear = feels_real(DISPLAY, populations(0.0, 0.2), OMEGA, central=LEVEL, decision=DECISION)
    assert clear.draws == 512
    users = populations(0.0, 0.2, spread=1.04)
    at_threshold = feels_real(DISPLAY, users, OMEGA, central=LEVEL, decision=DECISION)
    assert at_threshold.draws > clear.draws or at_threshold.clear_of(DECISION)
    straddling = Evidence(
        probability=0.95, magnitude=0.95, plane=1.0, error=0.01, by_central=(),
        scores=np.zeros(512), real=np.ones(512, dtype=bool),
    )  # fmt: skip
    assert not straddling.clear_of(DECISION)
    # Stiffness and damping do not say it, and of few subjects abs(Z_h) does not alone.
    outside = dataclasses.replace(straddling, probability=0.01)
    assert outside.outcome(DECISION, 6) == "does not"
    assert outside.outcome(DECISION, 5) == "too little data"
    assert dataclasses.replace(outside, plane=0.01).outcome(DECISION, 5) == "does not"


def test_scores_are_those_of_the_share_below():
    # With one damping for all and at low omega abs(Z_h) orders users as their stiffness does.
    users = Users(True, np.log([[300.0], [2.0]]), np.array([[0.2], [1e-4]]), np.zeros(1))
    (found,) = search_scores(DISPLAY, users, np.array([0.1]), EDGES).at_omega[0]
    assert found == pytest.approx(np.log(500.0 / 300.0) / 0.2, abs=1e-5)
