"""What each subject did, against plain loops."""

import math
import statistics

import pytest

from percept import Scene, Sessions, read_sessions
from percept.study.data import Data, what_was_read
from tests import DATASETS

SESSIONS = read_sessions(DATASETS / "hbfd_sessions.csv")


def kept(subjects, drop=()):
    """The first subjects of the shipped data, without some of their rows."""
    table = SESSIONS.table
    table = table[table["subject"].isin(SESSIONS.subjects[:subjects])]
    return Sessions.from_frame(table.drop(index=list(drop)))


@pytest.mark.parametrize("subjects", [2, 3, 10])
@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_rows_are_those_of_plain_lists(subjects, family):
    # One subject lacks an environment, and another has one alone.
    sessions = kept(subjects, drop=(1, 5, 6, 7, 8))
    is_log = family == "lognormal"
    values: dict[str, dict[str, float]] = {}
    for row in sessions.table.itertuples():
        ratio = row.b_adj / row.b_ref
        found = math.log(ratio) if is_log else ratio - 1.0
        values.setdefault(row.subject, {})[row.environment] = found
    middle = {
        name: statistics.fmean(of[name] for of in values.values() if name in of)
        for name in sessions.environments
    }
    off = {who: statistics.fmean(of[n] - middle[n] for n in of) for who, of in values.items()}
    rows = what_was_read(Data(sessions, Scene(inference={"family": family}))).people
    for row in (row for row in rows if row.parameter == "b"):
        own = list(values[row.subject].values())
        mean = statistics.fmean(own)
        assert row.mean == pytest.approx(math.expm1(mean) if is_log else mean, rel=1e-12)
        assert row.n == len(own)
        assert row.sd == (pytest.approx(statistics.stdev(own)) if len(own) > 1 else None)
        others = [value for who, value in off.items() if who != row.subject]
        distance = None
        if len(others) > 1:
            apart = off[row.subject] - statistics.fmean(others)
            distance = pytest.approx(apart / statistics.stdev(others), rel=1e-9)
        assert row.distance == distance


def test_published_limits_have_neither_cells_nor_people():
    read = what_was_read(Data(read_sessions(DATASETS / "hbfd_table1.csv"), Scene()))
    assert (read.cells, read.people, read.design) == ((), (), None)
