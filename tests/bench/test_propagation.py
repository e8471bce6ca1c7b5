"""Ways to a band: what each costs, and how far it is off."""

import numpy as np
import pytest

from percept import Scene, Study, read_sessions
from percept.bench.propagation import propagation_costs, study_propagation
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
