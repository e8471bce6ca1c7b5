"""Ways to curves: what each costs, how far it is off, and what it holds in memory."""

import itertools

import numpy as np
import pytest

from percept import Scene, Study, read_sessions
from percept.bench.propagation import (
    envelope_costs,
    magnitude_cost,
    points_in,
    propagation_costs,
    propagation_memory,
    study_propagation,
)
from percept.haptics import Device
from percept.sessions import Sessions
from tests import DATASETS


@pytest.fixture(scope="module")
def study():
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=0.2)
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    return Study(Sessions.from_frame(table[table["environment"].isin(["VE2", "VE4"])]), scene)


def test_fewer_draws_and_frequencies_cost_what_is_reported():
    rng = np.random.default_rng(2)
    k, b = np.exp(9.0 + 0.05 * rng.standard_normal(20_000)), np.exp(2.0 + 0.2 * rng.standard_normal(20_000))
    found = propagation_costs(
        Device(1.0, 5.0), k, b, 1e-3, kept=16_000, name="VE", frequencies=(0.1, 100.0, 60), repeats=1
    )
    ours, others = ([one for one in found if one.way == way] for way in ("percept", "all draws"))
    assert [(one.draws, one.bound) for one in ours] == [
        (draws, bound) for draws in (1000, 4000, 16_000) for bound in (1e-2, 1e-3)
    ]
    assert [(one.draws, one.points) for one in others] == [(20_000, 25), (20_000, 60)]
    assert others[-1].error == others[-1].worst_error == 0.0
    assert others[-1].ratio == 1.0
    # A tail of 0.5 % of n draws has a standard error of 1.9/sqrt(n) of the half-width.
    for one in ours:
        assert one.error <= one.worst_error < 5 * 1.9 / np.sqrt(one.draws) + one.bound
    assert ours[-1].error < ours[0].error
    # The same draws, but lines between 25 points spaced evenly, over a dip that percept's points follow.
    assert ours[-1].error < others[0].error < 0.5


def test_a_task_in_its_own_process_stays_in_the_stated_bound():
    found = propagation_memory(draws=100_000, points=30, environments=2)
    assert found.values == 6_000_000
    # Two blocks at once fill memory enough to be seen; the bound holds whatever the number of frequencies.
    assert found.bound / 20 < found.held < found.bound


def test_every_environment_of_a_study_is_timed(study):
    found = study_propagation(study, frequencies=(0.1, 100.0, 20), repeats=1)
    assert {cost.environment for cost in found} == {"VE2", "VE4"}
    kept = next(d for d in study.curve_draws if (d.method, d.kind) == ("bayesian", "user"))
    for cost in found:
        if (cost.way, cost.bound) == ("percept", 1e-3):
            assert cost.draws <= kept.pairs["VE4"][0].size
            # Both are draws of one posterior: limits differ by Monte Carlo error, and by the lines' share.
            assert cost.worst_error < 0.15 * np.sqrt(kept.pairs["VE4"][0].size / cost.draws)
        else:
            assert cost.way == "percept" or cost.draws > kept.pairs["VE4"][0].size


def test_points_come_nearer_and_percept_is_exact(study):
    found = envelope_costs(study, frequencies=60, repeats=1)
    assert [(one.environment, one.region) for one in found[::4]] == [
        ("VE2", "rectangle"), ("VE4", "rectangle"), ("VE2", "ellipse"), ("VE4", "ellipse"),
    ]  # fmt: skip
    for first in range(0, len(found), 4):
        ours, *points = found[first : first + 4]
        assert (ours.way, ours.points, ours.ratio, ours.error) == ("percept", None, 1.0, 0.0)
        assert [one.points for one in points] == (
            [64, 1024, 16_384] if ours.region == "rectangle" else [40, 160, 640]
        )
        errors = [one.error for one in points]
        # Where corners are all there is to it, points have them too, and differ by rounding.
        assert all(later <= earlier + 1e-12 for earlier, later in itertools.pairwise(errors))
        assert errors[-1] < 0.01
    assert max(one.error for one in found if one.points == 40) > 0.001


@pytest.mark.parametrize("shape", ["rectangle", "ellipse"])
def test_points_lie_in_their_region_and_on_its_edge(study, shape):
    region = next(
        r for r in study.regions if r.method == "bayesian" and (r.ellipse is None) == (shape == "rectangle")
    )
    depths = region.depths(*points_in(region, 16))
    assert (depths > -1e-9).all()
    # The farthest point always lies on the edge.
    assert depths.min() < 1e-9


def test_scratch_of_magnitudes_is_small_beside_the_result():
    cost = magnitude_cost(omegas=100, environments=5, draws=4000, repeats=1)
    assert cost.result_bytes == 100 * 5 * 4000 * 8
    assert cost.scratch_bytes < cost.result_bytes / 8
    assert cost.ratio == cost.seconds / cost.hypot_seconds
