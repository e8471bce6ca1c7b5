"""A short run of the fuzzer, and proof that its checks can fail."""

from __future__ import annotations

from dataclasses import replace

import pytest

from percept.sessions import read_sessions
from tests import LONG
from tests.sessions.dialects import WRITERS, example
from tests.sessions.fuzz import check, fuzz

FILES = 10_000 if LONG else 80


@pytest.mark.evidence(reduced=True)
def test_mutated_files_are_read_rightly_or_refused():
    outcome = fuzz(FILES, seed=20)
    assert outcome.failures == []
    assert outcome.files == FILES
    # A reader that refuses everything would pass the line above.
    assert outcome.accepted > FILES / 10


def test_the_scan_notices_a_changed_number_and_a_lost_row(tmp_path):
    writer = WRITERS["psychopy european"]
    (data,) = writer.write(example()).values()
    file = tmp_path / "f.csv"
    file.write_bytes(data)
    sessions = read_sessions(file)
    assert check(sessions, data, writer.options) is None
    changed = sessions.table.copy()
    changed.loc[3, "k_adj"] *= 1000
    assert "k_adj" in (check(replace(sessions, table=changed), data, writer.options) or "")
    lost = replace(sessions, table=sessions.table.iloc[1:])
    assert "rows became" in (check(lost, data, writer.options) or "")
