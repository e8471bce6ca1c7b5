"""Bands from sets of the draws: what each costs, how far it is off, and how its error falls."""

import pytest

from percept import Scene, Study, read_sessions
from percept.haptics import Device
from percept.sessions import Sessions
from reports.benchmark.propagation import propagation_costs, study_propagation
from tests import DATASETS
from tests.boundary.test_law import mixture


def test_sixteen_times_the_draws_divide_the_error_by_four():
    sixteenth, quarter, whole = propagation_costs(
        Device(1.0, 5.0), 1e-3, mixture(8192), name="VE", frequencies=(0.1, 100.0, 20)
    )
    assert [row.draws for row in (sixteenth, quarter, whole)] == [512, 2048, 8192]
    assert whole.falls == pytest.approx(4.0, rel=0.25)
    assert quarter.falls == pytest.approx(2.0, rel=0.25)
    assert sixteenth.falls == 1.0
    # Sets and the whole share their draws: a set differs by sqrt(1 - 1/sets) of its own error.
    assert sixteenth.difference == pytest.approx(sixteenth.stated * (15 / 16) ** 0.5, rel=0.4)
    assert whole.difference == 0.0


@pytest.mark.evidence
def test_every_environment_of_a_study_is_timed():
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=0.2)
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    study = Study(Sessions.from_frame(table[table["environment"].isin(["VE2", "VE4"])]), scene)
    found = study_propagation(study, frequencies=(0.1, 100.0, 10))
    assert {(cost.environment, cost.kind) for cost in found if cost.sets == 1} == {
        (name, kind) for name in ("VE2", "VE4") for kind in ("mean", "user")
    }
    assert max(cost.draws for cost in found) == len(study.parts.fit.points)
    for cost in found:
        assert cost.difference < 2.0 * cost.stated
