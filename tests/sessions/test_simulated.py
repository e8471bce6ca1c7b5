import pandas as pd
import pytest

from percept.sessions import Sessions, read_sessions
from tests import DATASETS


def test_simulated_sessions_say_so():
    assert read_sessions(DATASETS / "hbfd_sessions.csv").simulated
    assert not read_sessions(DATASETS / "hbfd_table1.csv").simulated


@pytest.mark.parametrize(("source", "simulated"), [("simulated", True), ("laboratory", False)])
def test_the_source_column_decides(source, simulated):
    frame = pd.DataFrame(
        {"subject": ["a", "b"], "environment": ["V", "V"], "k_ref": 10.0, "k_adj": [9.0, 11.0]}
    )
    sessions = Sessions.from_frame(frame.assign(source=source))
    assert sessions.simulated is simulated
    assert list(sessions.table["source"]) == [source, source]
    assert not Sessions.from_frame(frame).simulated
