"""Ways to a band: what each costs, how far it is off, and how its error falls with the draws."""

import pytest

from percept import Scene, Study, read_sessions
from percept.bench.propagation import propagation_costs, study_propagation
from percept.haptics import Device
from percept.sessions import Sessions
from tests import DATASETS
from tests.boundary.test_law import mixture


def test_sixteen_times_the_draws_divide_the_error_by_four():
    found = propagation_costs(
        Device(1.0, 5.0), *mixture(8192), 1e-3, name="VE", frequencies=(0.1, 100.0, 20), repeats=1
    )
    ours, others = ([one for one in found if one.way == way] for way in ("percept", "draws"))
    assert [one.draws for one in ours] == [one.draws for one in others] == [32, 128, 512, 2048, 8192]
    falls = [one.falls for one in ours]
    assert falls[:2] == [None, None]
    # An error of 31 degrees of freedom has a standard error of 13 %, its ratio to another one of 18 %.
    assert falls[2:] == pytest.approx([4.0] * 3, rel=0.45)
    assert all(one.stated is one.falls is None for one in others)
    for one in ours:
        assert one.difference < 4.0 * one.stated
    assert all(other.difference > 0.0 for other in others)
    assert ours[-1].difference == 0.0


def test_every_environment_of_a_study_is_timed():
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=0.2)
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    study = Study(Sessions.from_frame(table[table["environment"].isin(["VE2", "VE4"])]), scene)
    found = study_propagation(study, frequencies=(0.1, 100.0, 10), repeats=1)
    assert {cost.environment for cost in found} == {"VE2", "VE4"}
    assert max(cost.draws for cost in found) == len(study.fit.points)
    for cost in found:
        if cost.way == "percept":
            assert cost.difference < 4.0 * cost.stated
