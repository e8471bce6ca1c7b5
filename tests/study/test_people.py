"""What each subject did, against plain loops."""

import math
import statistics

import pytest

from percept import Scene, Sessions, read_sessions
from percept.study.data import Data
from tests import DATASETS

SESSIONS = read_sessions(DATASETS / "hbfd_sessions.csv")


def kept(subjects, drop=()):
    """The first subjects of the shipped data, without some of their rows."""
    table = SESSIONS.table
    table = table[table["subject"].isin(SESSIONS.subjects[:subjects])]
    return Sessions.from_frame(table.drop(index=list(drop)))


def slow_rows(sessions, parameter, deviation):
    """Mean, SD and distance of each subject, by loops over lists."""
    cells = {}
    for row in sessions.table.to_dict("records"):
        value = deviation(row[f"{parameter}_adj"], row[f"{parameter}_ref"])
        cells.setdefault((row["subject"], row["environment"]), []).append(value)
    means = {cell: statistics.fmean(values) for cell, values in cells.items()}
    centre = {}
    for environment in sessions.environments:
        of_environment = [value for (_, name), value in means.items() if name == environment]
        centre[environment] = statistics.fmean(of_environment)
    own = {}
    for subject in sessions.subjects:
        own[subject] = statistics.fmean(
            value - centre[name] for (who, name), value in means.items() if who == subject
        )
    for subject in sessions.subjects:
        values = [value for (who, _), value in means.items() if who == subject]
        others = [value for who, value in own.items() if who != subject]
        distance = None
        if len(others) > 1:
            distance = (own[subject] - statistics.fmean(others)) / statistics.stdev(others)
        sd = statistics.stdev(values) if len(values) > 1 else None
        yield subject, statistics.fmean(values), sd, distance


@pytest.mark.parametrize("subjects", [2, 3, 4, 10])
@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_rows_are_those_of_plain_loops(subjects, family):
    # One subject lacks an environment, and another has one alone.
    sessions = kept(subjects, drop=(1, 5, 6, 7, 8))
    deviation = {
        "lognormal": lambda adjusted, reference: math.log(adjusted / reference),
        "normal": lambda adjusted, reference: adjusted / reference - 1.0,
    }[family]
    scene = Scene(inference={"family": family})
    for parameter in ("k", "b"):
        rows = [row for row in Data(sessions, scene).people if row.parameter == parameter]
        slow = list(slow_rows(sessions, parameter, deviation))
        assert [row.subject for row in rows] == [subject for subject, *_ in slow]
        for row, (_, mean, sd, distance) in zip(rows, slow, strict=True):
            mean = math.expm1(mean) if family == "lognormal" else mean
            assert row.mean == pytest.approx(mean, rel=1e-12)
            assert row.sd == (None if sd is None else pytest.approx(sd, rel=1e-12))
            wanted = None if distance is None else pytest.approx(distance, rel=1e-9)
            assert row.distance == wanted
        assert [row.n for row in rows][:2] == [4, 1]


def test_published_limits_have_no_rows():
    assert list(Data(read_sessions(DATASETS / "hbfd_table1.csv"), Scene()).people) == []
