from __future__ import annotations

import numpy as np

from percept.bench.propagation import propagation_cost, propagation_memory
from percept.haptics import Device


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


def test_memory_of_a_large_study_stays_in_its_bound() -> None:
    peak, bound = propagation_memory(Device(1.0, 5.0), draws=100_000, points=30, environments=2)
    assert 0 < peak < bound
