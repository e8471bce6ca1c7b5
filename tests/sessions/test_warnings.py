"""What is seldom meant is said, with its place, and nothing is left out."""

from __future__ import annotations

import pandas as pd
import pytest

from percept import read_sessions
from percept.sessions import Sessions, format_validation, validate
from tests import DATASETS

HEADER = "subject,environment,k_ref,b_ref,k_adj,b_adj"
CLEAN = [f"{s},{e},{k},{b},{k * (1 + s / 10)},{b * (1 - s / 20)}" for s in (1, 2, 3, 4) for e, k, b in (
    ("soft", 100.0, 1.0), ("hard", 2000.0, 10.0))]  # fmt: skip


def warnings_of(tmp_path, rows):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return [str(warning).removeprefix(f"{tmp_path}/") for warning in read_sessions(path).warnings]


def test_ordinary_studies_raise_none(tmp_path):
    assert warnings_of(tmp_path, CLEAN) == []
    for name in ("hbfd_sessions.csv", "hbfd_table1.csv"):
        assert read_sessions(DATASETS / name).warnings == ()


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (71900.0, None),
        (72100.0, "set k to 72100 in 'hard', 30 times the median of 2400 there: a slip?"),
        (77.0, None),
        (76.0, "set k to 76 in 'hard', 0.033 times the median of 2300 there: a slip?"),
    ],
)
def test_a_value_far_from_all_others_of_its_environment(tmp_path, value, said):
    # The median of 2200, 2400, 2400 and a large value is 2400, that with a small one 2300.
    rows = [f"{s},hard,2000,10,{k},{9 + s}" for s, k in ((1, 2200), (2, 2400), (3, 2400), (4, value))]
    assert warnings_of(tmp_path, rows) == ([f"s.csv:5:k_adj: subject '4' {said}"] if said else [])


def test_two_subjects_say_nothing_of_each_other(tmp_path):
    assert warnings_of(tmp_path, ["1,a,100,1,9000,1.1", "2,a,100,1,110,0.9"]) == []


def test_values_without_a_logarithm(tmp_path):
    rows = [*CLEAN, "5,soft,100,1,0,1.2", "5,hard,2000,10,-3,11"]
    assert warnings_of(tmp_path, rows) == [
        "s.csv:10:k_adj: 2 values of k are zero or negative, here the first: the lognormal family, the "
        "default, takes none"
    ]


def test_a_knob_that_never_moved(tmp_path):
    still = ["8,soft,100,1,100,1.1", "8,hard,2000,10,2000,10"]
    once = ["9,soft,100,1,100,0.8", "9,hard,2000,10,1900,11"]
    assert warnings_of(tmp_path, [*CLEAN, *still, *once]) == [
        "k_adj: subject '8' left k at the reference in every trial: was what they set recorded?"
    ]


def test_cells_not_tried_are_named(tmp_path):
    assert warnings_of(tmp_path, CLEAN[:-1]) == ["1 cell has no trial: '4 at hard'"]
    assert warnings_of(tmp_path, [*CLEAN[1:3], *CLEAN[4:]]) == [
        "2 cells have no trial: '1 at soft', '2 at hard'"
    ]


def test_rows_of_a_filtered_table_keep_their_places(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([HEADER, *CLEAN, "5,soft,100,1,0,1.2"]) + "\n")
    sessions = read_sessions(path)
    kept = Sessions(
        sessions.table[sessions.table["subject"] != "1"], "trials", sessions.sources,
        provenance=sessions.provenance,
    )  # fmt: skip
    assert (kept.warnings[0].row, kept.warnings[0].column) == (10, "k_adj")


def test_validate_says_them(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([HEADER, *CLEAN[:-1]]) + "\n")
    assert "notice: 1 cell has no trial: '4 at hard'" in format_validation(validate(path)).splitlines()


def test_of_many_slips_the_first_are_named(tmp_path):
    rows = [f"{s},hard,2000,10,{100_000 if s > 22 else 2200 + s},{9 + s / 40}" for s in range(1, 31)]
    found = warnings_of(tmp_path, rows)
    assert [text.partition(": ")[0] for text in found] == [f"s.csv:{row}:k_adj" for row in range(24, 29)] + [
        "k_adj"
    ]
    assert found[-1] == "k_adj: and 3 more values of k as far from the median there"


def test_many_subjects_are_looked_up_once(tmp_path):
    """Rows are gone over a few times, not once for every subject."""

    class Counting(pd.DataFrame):
        seen = 0

        def __getitem__(self, key):
            Counting.seen += 1
            return super().__getitem__(key)

    table = pd.DataFrame(
        [(str(s), "1", e, 100.0, 1.0, 1, 101.0 + s, 1.1) for s in range(300) for e in ("A", "B")],
        columns=["subject", "session", "environment", "k_ref", "b_ref", "trial", "k_adj", "b_adj"],
    )
    sessions = Sessions.from_frame(table.iloc[1:])
    counted = Sessions(Counting(sessions.table), "trials", sessions.sources, provenance=sessions.provenance)
    assert [str(warning) for warning in counted.warnings] == ["1 cell has no trial: '0 at A'"]
    assert Counting.seen < 60


def test_sessions_put_together_by_hand_have_no_places(tmp_path):
    rows = [(str(s), "1", "A", 100.0, 1.0, 1, 101.0 + s if s else 9e4, 1.1) for s in range(5)]
    names = ["subject", "session", "environment", "k_ref", "b_ref", "trial", "k_adj", "b_adj"]
    (slip,) = Sessions(pd.DataFrame(rows, columns=names), "trials").warnings
    assert (slip.file, slip.row, slip.column) == (None, None, "k_adj")
    assert slip.text.startswith("subject '0' set k to 90000 in 'A', ")
