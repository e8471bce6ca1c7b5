"""What the hierarchical model is given, by hand, and the scatter that it is refused."""

import re

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study
from percept.errors import RefusalError
from percept.inference.model.statistics import from_trials
from percept.sessions import Sessions
from percept.sessions.quantities import IMPEDANCE
from percept.study.data import Data
from percept.study.prepare import prepare
from percept.study.responses import lacking_scatter
from tests.study.checked import table_of


def test_a_step_counts_relative_to_where_the_subjects_adjusted():
    """All set 2000 N/m at a reference of 1000: a step of 10 is one of 10/2000, uniform within."""
    table = table_of(("k", "b"), subjects=4)
    table.loc[table["environment"] == "VE2", "k_adj"] = 2000.0
    scene = Scene(model={"resolution": {"k": 10.0, "b": 0.1}})
    found = prepare(Data(Sessions.from_frame(table), scene)).model.resolution
    np.testing.assert_allclose(
        found.between, [[0, (10 / 2000) ** 2 / 12, 0], [0, 0, 0]], rtol=1e-12
    )


def lacking(response, subject, environment, steps):
    """What lacks scatter in three environments."""
    statistics = from_trials(
        response,
        subject,
        environment,
        np.array([[-1.0, 0.0, 1.0]] * 2),
        parameters=("k", "b"),
        environments=("A", "B", "C"),
        subjects=tuple(f"S{i}" for i in range(subject.max() + 1)),
    )
    return lacking_scatter(statistics, steps, IMPEDANCE)


def study(seed, *, trials=2):
    """Independent scatter at every level: responses (N, 2), subject, environment."""
    rng = np.random.default_rng(seed)
    index = np.array([(s, e) for s in range(5) for e in range(3) for _ in range(trials)])
    cell = rng.normal(0, 0.2, (5, 3, 2))[index[:, 0], index[:, 1]]
    return cell, rng.normal(0, 0.1, cell.shape), index[:, 0], index[:, 1]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rest", [0.0, 1e-9])
@pytest.mark.parametrize("level", ["trials", "means"])
def test_proportion_is_refused(level, sign, rest):
    """Exact, or at a correlation of 1 - 1e-9."""
    cell, trial, *where = study(1, trials=2 if level == "trials" else 1)
    part = trial if level == "trials" else cell
    part[:, 1] = sign * 0.7 * (part[:, 0] + np.sqrt(2.0 * rest) * part[:, 1])
    response = cell + trial if level == "trials" else cell
    what = "a subject's trials" if level == "trials" else "the subjects' means"
    with pytest.raises(RefusalError, match=rf"stiffness and damping of {what} move in proportion"):
        lacking(response, *where, ())
    between, trial = lacking(response, *where, ("k", "b"))
    assert trial.all() == (level == "trials")
    assert between.all() == (level == "means")
    # One step is enough to end a proportion.
    between, trial = lacking(response, *where, ("b",))
    assert not trial[0].any()
    assert not between[0].any()


def test_no_scatter_is_refused_with_the_step_to_give():
    cell, _, subject, environment = study(5, trials=1)
    cell[environment == 2, 0] = 0.25
    message = (
        "all subjects made the same adjustments in stiffness of C: zero scatter has no proper "
        "posterior."
    )
    with pytest.raises(RefusalError, match=re.escape(message)) as caught:
        lacking(cell, subject, environment, ("b",))
    assert "resolution.k" in caught.value.hint


def test_a_step_makes_up_for_scatter_only_where_there_is_none():
    cell, trial, subject, environment = study(7)
    between, _ = lacking(cell + trial, subject, environment, ("k", "b"))
    assert not between.any()
    # Between subjects: their means alike in one cell. Between trials: every subject's alike in
    # another.
    cell[environment == 2, 0] = trial[environment == 2, 0] = 0.0
    trial[environment == 1, 1] = 0.0
    between, of_trials = lacking(cell + trial, subject, environment, ("k", "b"))
    np.testing.assert_array_equal(between, [[False, False, True], [False, False, False]])
    np.testing.assert_array_equal(of_trials, [[False, False, True], [False, True, False]])


def test_classical_alone_refuses_where_nothing_scatters():
    subjects = pd.DataFrame({"subject": ["S01", "S02", "S03"]})
    table = subjects.assign(environment="A", k_ref=10.0, k_adj=11.0)
    study = Study(table, Scene(inference={"method": "classical"}))
    with pytest.raises(RefusalError, match="no interval of anything: stiffness in A, say, where"):
        _ = study.intervals
