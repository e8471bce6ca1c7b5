from __future__ import annotations

import numpy as np

from percept import Scene, Study, read_sessions
from percept.bench.propagation import propagation_cost, propagation_memory, study_propagation
from percept.haptics import Device
from percept.sessions import Sessions


def test_fewer_draws_and_frequencies_cost_what_is_reported() -> None:
    rng = np.random.default_rng(2)
    k, b = np.exp(9.0 + 0.05 * rng.standard_normal(20_000)), np.exp(2.0 + 0.2 * rng.standard_normal(20_000))
    few = propagation_cost(Device(1.0, 5.0), k, b, 1e-3, kept=2_000, frequencies=(0.1, 100.0, 60))
    all_of_them = propagation_cost(Device(1.0, 5.0), k, b, 1e-3, kept=20_000, frequencies=(0.1, 100.0, 60))
    # A tail of 0.5 % of 2000 draws has a standard error of some 4 % of the half-width, and 60 limits of
    # strongly dependent curves hardly more than that; the same draws leave the lines only.
    assert few.error < 5 * 0.05
    assert all_of_them.error < 0.03
    assert (few.draws, few.naive_draws, few.naive_points) == (2_000, 20_000, 60)


def test_a_task_in_its_own_process_stays_in_the_stated_bound() -> None:
    found = propagation_memory(Device(1.0, 5.0), draws=100_000, points=30, environments=2)
    assert found.values == 6_000_000
    # Two blocks at once fill memory enough to be seen; the bound holds whatever the number of frequencies.
    assert found.bound / 20 < found.held < found.bound


def test_every_environment_of_a_study_is_timed() -> None:
    scene = Scene.load("datasets/hbfd.toml").with_inference(tolerance=0.2)
    table = read_sessions("datasets/hbfd_sessions.csv").table
    study = Study(Sessions.from_frame(table[table["environment"].isin(["VE2", "VE4"])]), scene)
    found = study_propagation(study, frequencies=(0.1, 100.0, 20))
    assert len(found) == 2
    kept = next(d for d in study.curve_draws if (d.method, d.kind) == ("bayesian", "user"))
    for cost in found:
        assert cost.draws == kept.pairs["VE2"][0].size
        assert cost.naive_draws > cost.draws
        # Both are draws of one posterior: the limits differ by Monte Carlo error, and the lines' share of it.
        assert cost.error < 0.15
