"""What is written and read in any dialect comes back identical or is refused; never different."""

from __future__ import annotations

import csv
import math

import hypothesis.strategies as st
import pandas as pd
import pytest
from hypothesis import HealthCheck, assume, given, settings

from percept import Scene
from percept.errors import UsageError
from percept.sessions import Sessions, read_sessions
from percept.sessions.values import fold
from tests import LONG
from tests.sessions.dialects import Trial, delimited, frame

NUMBERS = ("k_ref", "b_ref", "k_adj", "b_adj")
easy = st.text(st.sampled_from("aZé01_- "), min_size=1, max_size=4).filter(str.strip)
nasty = st.text(st.sampled_from("ab01,;\t\"\\'\n\r =+-@{}<&\u2028\ufeffé")).filter(str.strip)
anything = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1
).filter(str.strip)
ids = st.one_of(easy, nasty, anything)
positive = st.floats(1e-99, 1e99)
factors = st.floats(0.1, 9.0)


@st.composite
def studies(draw, names=ids):
    subjects = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    environments = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    references = [(draw(positive), draw(positive)) for _ in environments]
    trials = []
    for subject in subjects:
        session = draw(names)
        for environment, (k, b) in zip(environments, references, strict=True):
            for trial in range(draw(st.integers(1, 2))):
                k_adj, b_adj = k * draw(factors), b * draw(factors)
                b_adj = None if draw(st.integers(0, 9)) == 0 else b_adj
                trials.append(Trial(subject, session, environment, trial, k, b, k_adj, b_adj))
    # Spellings of one name come back as the first of them.
    for spelled in (subjects, environments, [trial.session for trial in trials]):
        assume(len({fold(name) for name in spelled}) == len(set(spelled)))
    return trials


def same(sessions, trials):
    """Compare as plain Python values: no helper of the reader's own takes part."""
    table = sessions.table
    want = frame(trials)
    for column in ("subject", "session", "environment", "trial"):
        assert table[column].tolist() == want[column].tolist()
    for column in NUMBERS:
        for got, expected in zip(table[column].tolist(), want[column].tolist(), strict=True):
            missing = expected is None or math.isnan(expected)
            assert math.isnan(got) if missing else got == expected


@pytest.mark.evidence(reduced=True)
@settings(max_examples=1500 if LONG else 25, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    trials=studies(),
    delimiter=st.sampled_from([",", ";", "\t", "|"]),
    mark=st.sampled_from([".", ","]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    quoting=st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL]),
    declared=st.booleans(),
)
def test_delimited(tmp_path_factory, trials, delimiter, mark, encoding, newline, quoting, declared):
    header = ["subject", "session", "environment", "trial", *NUMBERS]
    records = [header] + [
        [t.subject, t.session, t.environment, str(t.trial)]
        + [
            "" if v is None else repr(v).replace(".", mark)
            for v in (t.k_ref, t.b_ref, t.k_adj, t.b_adj)
        ]
        for t in trials
    ]
    file = tmp_path_factory.mktemp("r") / "f.csv"
    try:
        file.write_bytes(
            delimited(
                records, delimiter=delimiter, newline=newline, encoding=encoding, quoting=quoting
            )
        )
    except UnicodeEncodeError:
        return
    options = Scene(sessions={"decimal": mark, "delimiter": delimiter}) if declared else Scene()
    try:
        sessions = read_sessions(file, scene=options)
    except UsageError:
        return
    same(sessions, trials)


@pytest.mark.evidence(reduced=True)
@settings(max_examples=400 if LONG else 8, deadline=None, suppress_health_check=list(HealthCheck))
@given(trials=studies())
def test_own_csv_is_never_refused(tmp_path_factory, trials):
    want = Sessions.from_frame(frame(trials))
    file = tmp_path_factory.mktemp("o") / "own.csv"
    # A bare carriage return would end a line.
    want.table.to_csv(file, index=False, quoting=csv.QUOTE_NONNUMERIC)
    got = read_sessions(file)
    pd.testing.assert_frame_equal(got.table, want.table, check_exact=True)
