"""Published tables: digits kept, and each way of being wrong named with its place."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from numpy.testing import assert_allclose

from percept.errors import UsageError
from percept.simulate import PublishedLimits, read_summary

HEADER = "environment,parameter,reference,lower,upper,n,level\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "limits.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_means_and_sds_behind_table_1() -> None:
    table = read_summary(Path(__file__).parents[2] / "datasets" / "hbfd_table1.csv")
    # Worked out from the printed limits with t(.995; 9) = 3.249836, to the digits shown.
    assert_allclose(table.factor, 3.249836 / 10**0.5, rtol=2e-7)
    assert_allclose(table.mean[[0, 0, 4], [0, 1, 1]], [14.914, 0.68455, 96.1365], rtol=1e-12)
    assert_allclose(table.sd[[0, 0, 1, 3], [0, 1, 0, 0]], [3.9954, 0.63147, 35.200, 803.75], rtol=2e-5)


def test_trailing_zeros_are_digits(tmp_path: Path) -> None:
    table = read_summary(written(tmp_path, HEADER + "a,k,10,9.50,10.500,8,0.95\n"))
    assert (str(table.lower[0][0]), str(table.upper[0][0])) == ("9.50", "10.500")


def test_numbers_count_with_their_shortest_text() -> None:
    frame = pd.DataFrame(
        [["a", "b", 1.0, 0.1, 0.3, 8, 0.95], ["a", "k", 10.0, 9.5, 10.5, 8, 0.95]],
        columns=HEADER.strip().split(","),
    )
    table = PublishedLimits.from_table(frame)
    assert table.parameters == ("k", "b")
    assert [str(limit) for limit in table.lower[0]] == ["9.5", "0.1"]
    assert (table.n, table.level) == (8, 0.95)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("environment,parameter\na,k\n", r"limits\.csv, column 'reference': the summary has no such column"),
        (HEADER, r"limits\.csv: the summary has no rows"),
        ("", r"limits\.csv: the summary cannot be read: No columns"),
        (HEADER + "a,k,1,0,x,8,0.9\n", r"limits\.csv:2, column 'upper', value 'x': a number is needed"),
        (
            HEADER + "\na,k,1,0,nan,8,0.9\n",
            r"limits\.csv:3, column 'upper', value 'nan': a number is needed",
        ),
        (HEADER + "a,k,1,,2,8,0.9\n", r"limits\.csv:2, column 'lower', value '': a number is needed"),
        (
            HEADER + "a,m,1,0,2,8,0.9\n",
            r"limits\.csv:2, column 'parameter', value 'm': a parameter is k or b",
        ),
        (
            HEADER + "a,k,1,0,2,8,0.9\na,k,1,0,2,8,0.9\n",
            r"limits\.csv:3, column 'parameter', value 'k': a, k was given before, in row 2",
        ),
        (
            HEADER + "a,k,1,2,2.0,8,0.9\n",
            r"limits\.csv:2, column 'upper', value '2\.0': the upper limit must be above the lower one, 2",
        ),
        (
            HEADER + "a,k,1,0,2,8,0.9\na,b,1,0,2,8,0.9\nc,k,1,0,2,8,0.9\n",
            r"column 'parameter': c has no row for b",
        ),
        (
            HEADER + "a,k,1,0,2,8,0.9\na,b,1,0,2,9,0.9\n",
            r"limits\.csv:3, column 'n', value '9': all rows must have the same n; the first has 8",
        ),
        (
            HEADER + "a,k,1,0,2,8,0.9\na,b,1,0,2,8,0.99\n",
            r"limits\.csv:3, column 'level', value '0\.99': all rows must have the same level",
        ),
        (HEADER + "a,k,1,0,2,1,0.9\n", r"column 'n', value '1': n must be a whole number"),
        (HEADER + "a,k,1,0,2,2.5,0.9\n", r"column 'n', value '2\.5': n must be a whole number"),
        (HEADER + "a,k,1,0,2,8,99\n", r"column 'level', value '99': the level must lie between 0 and 1"),
        (HEADER + "a,k,1,0,2,8,0.9,extra\n", r"limits\.csv: a row has more fields than the header"),
    ],
)
def test_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        read_summary(written(tmp_path, text))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.csv: the summary cannot be read"):
        read_summary(tmp_path / "none.csv")
    path = tmp_path / "latin.csv"
    path.write_bytes(HEADER.encode() + "\u00e9,k,1,0,2,8,0.9\n".encode("cp1252"))
    with pytest.raises(UsageError, match=r"latin\.csv: the summary cannot be read"):
        read_summary(path)
