"""Published tables: digits kept, and each way of being wrong named with its place."""

from __future__ import annotations

import zipfile
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
from numpy.testing import assert_allclose

from percept.cli import main
from percept.errors import UsageError
from percept.sessions import ReadOptions
from percept.simulate import PublishedLimits, read_summary
from tests import DATASETS

HEADER = "environment,parameter,reference,lower,upper,n,level\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "limits.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_means_and_sds_behind_table_1() -> None:
    table = read_summary(DATASETS / "hbfd_table1.csv")
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
        (
            "environment,parameter,reference,mean,sd,n\na,k,1,1,0.1,8\n",
            r"column 'lower': the summary has no such column\. Printed limits are what is reproduced;",
        ),
        (HEADER, r"limits\.csv: the summary has no rows"),
        (HEADER + "a,k,1,0,x,8,0.9\n", r"limits\.csv:2, column 'upper', value 'x': a number is needed"),
        (
            HEADER + "a,k,1,0,nan,8,0.9\n",
            r"limits\.csv:2, column 'upper', value 'nan': a number is needed",
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
    ],
)
def test_tables_that_are_refused(text: str, message: str) -> None:
    table = pd.read_csv(StringIO(text), dtype=str, keep_default_na=False)
    with pytest.raises(UsageError, match=message):
        PublishedLimits.from_table(table, file="limits.csv")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "environment,parameter\na,k\n",
            r"limits\.csv:1: no table of published limits; the columns are 'env",
        ),
        (
            "environment,parameter,mean,sd,reference,n\na,k,1,2,1,8\n",
            r"column 'lower': the summary has no such",
        ),
        (HEADER, r"limits\.csv:1: there are no data below the header"),
        ("", r"limits\.csv: the file is empty"),
        (HEADER + "\na,k,1,0,x,8,0.9\n", r"limits\.csv:3, column 'upper', value 'x': not a number"),
        (HEADER + "a,k,1,0,2,8,0.9,extra\n", r"limits\.csv:2, value .*: 8 cells where the header has 7"),
        (HEADER + "a,k,1,0,2,8,0.9\n\na,b,1,0,2,9,0.9\n", r"limits\.csv:4, column 'n', value '9': all rows"),
        (HEADER + "a,k,1000,2,3,8,0.9\n", r"limits\.csv:2, .*their units seem to differ"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        read_summary(written(tmp_path, text))


def test_digits_survive_every_dialect_and_a_scene(tmp_path: Path) -> None:
    text = "Wand;Parameter;Reference;Lower;Upper;n;level\nweich, a;k;10;9,50;10,500;8;0,95\n"
    options = ReadOptions.from_mapping({"columns": {"environment": "Wand"}})
    table = read_summary(written(tmp_path, text), options=options)
    assert (str(table.lower[0][0]), str(table.upper[0][0])) == ("9.50", "10.500")
    assert (table.environments, table.n, table.level) == (("weich, a",), 8, 0.95)


def test_simulate_reads_published_limits_by_a_scene(tmp_path: Path) -> None:
    path = written(tmp_path, HEADER.replace("environment", "Wand") + "a,k,10,9.50,10.50,8,0.95\n")
    scene, out = tmp_path / "scene.toml", tmp_path / "s.csv"
    scene.write_text('[columns]\nenvironment = "Wand"\n', encoding="utf-8")
    told = ["simulate", "--like", str(path), "--scene", str(scene), "--seed", "1", "--out", str(out)]
    assert main(told) == 0
    assert pd.read_csv(out)["k_adj"].mean() == pytest.approx(10, abs=0.005)


def test_an_archive_of_two_tables_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "both.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.csv", HEADER + "a,k,1,0,2,8,0.9\n")
        archive.writestr("b.csv", HEADER + "b,k,1,0,2,8,0.9\n")
    with pytest.raises(UsageError, match=r"both\.zip: 2 tables where one is needed"):
        read_summary(path)


def test_a_path_that_is_no_file(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.csv"):
        with pytest.raises(UsageError, match="there is no such file"):
            read_summary(path)
