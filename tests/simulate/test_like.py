"""Studies made like a published table: the limits exactly, the correlations as near as ten
subjects allow."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from percept import read_sessions
from percept.cli import main
from percept.errors import RefusalError, UsageError
from percept.published import (
    BETWEEN,
    CORRELATION,
    PublishedLimits,
    _match,
    simulate_like,
)
from percept.sessions import Sessions
from tests import DATASETS
from tests.simulate.conftest import correlations, printed_limits

TABLE1 = DATASETS / "hbfd_table1.csv"
PUBLISHED = read_sessions(TABLE1)
COLUMNS = ["environment", "parameter", "reference", "lower", "upper", "n", "level"]


def summary(*rows: tuple[object, ...], columns: list[str] = COLUMNS) -> Sessions:
    return Sessions.from_frame(pd.DataFrame(rows, columns=columns))


def test_means_and_sds_behind_table_1() -> None:
    table = PublishedLimits.from_sessions(PUBLISHED)
    # Worked out from the printed limits with t(.995; 9) = 3.249836, to the digits shown.
    assert_allclose(table.factor, 3.249836 / 10**0.5, rtol=2e-7)
    mean, sd = np.asarray(table.moments.mean), np.asarray(table.moments.sd)
    assert_allclose(mean[[0, 0, 4], [0, 1, 1]], [14.914, 0.68455, 96.1365], rtol=1e-12)
    assert_allclose(sd[[0, 0, 1, 3], [0, 1, 0, 0]], [3.9954, 0.63147, 35.200, 803.75], rtol=2e-5)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([("a", "k", 1, 2, 2.0, 8, 0.9)], r"a, k: the limits 2 and 2 must differ"),
        (
            [("a", "k", 1, 0, 2, 8, 0.9), ("a", "b", 1, 0, 2, 8, 0.9), ("c", "k", 1, 0, 2, 8, 0.9)],
            r"there is no row for c, b, though others have one",
        ),
        (
            [("a", "k", 1, 0, 2, 8, 0.9), ("a", "b", 1, 0, 2, 9, 0.9)],
            r"column 'n', value '9': all rows must have the same n; the first has 8",
        ),
        (
            [("a", "k", 1, 0, 2, 8, 0.9), ("a", "b", 1, 0, 2, 8, 0.99)],
            r"column 'level', value '0\.99': all rows must have the same level; the first has 0\.9",
        ),
    ],
)
def test_tables_that_are_refused(rows: list[tuple[object, ...]], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulate_like(summary(*rows), seed=1)


def test_sessions_are_no_published_limits() -> None:
    with pytest.raises(UsageError, match=r"hbfd_sessions\.csv: no table of published limits"):
        simulate_like(read_sessions(DATASETS / "hbfd_sessions.csv"), seed=1)


def test_the_command_reads_published_limits_by_a_scene(tmp_path: Path) -> None:
    path, scene, out = tmp_path / "limits.csv", tmp_path / "scene.toml", tmp_path / "s.csv"
    path.write_text("Wand;parameter;reference;lower;upper;n;level\na;k;10;9,50;10,50;8;0,95\n")
    scene.write_text('[columns]\nenvironment = "Wand"\n', encoding="utf-8")
    told = [
        "simulate",
        "--like",
        str(path),
        "--scene",
        str(scene),
        "--seed",
        "1",
        "--out",
        str(out),
    ]
    assert main(told) == 0
    assert pd.read_csv(out)["k_adj"].mean() == pytest.approx(10, abs=0.005)


@pytest.mark.parametrize("seed", range(2, 5))
def test_any_seed_prints_as_table_1(seed: int) -> None:
    sessions = simulate_like(PUBLISHED, seed=seed)
    assert (sessions[["k_adj", "b_adj"]] > 0).all(axis=None)
    for row in pd.read_csv(TABLE1, dtype=str).itertuples():
        values = sessions.loc[sessions["environment"] == row.environment, f"{row.parameter}_adj"]
        assert len(values) == 10
        limits = printed_limits(map(repr, values.tolist()), row.level, (row.lower, row.upper))
        assert limits == (row.lower, row.upper), (row.environment, row.parameter)


def test_correlations_as_stated() -> None:
    within, across = correlations(simulate_like(PUBLISHED, seed=3, subjects=4000))
    # An average of correlations scatters less than one of them, whose standard error is (1 -
    # r²)/√n.
    assert abs(within - CORRELATION) < 4 * (1 - CORRELATION**2) / math.sqrt(4000)
    assert abs(across - BETWEEN) < 4 * (1 - BETWEEN**2) / math.sqrt(4000)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (("w", "k", 10, -30, 20, 10, 0.99), r"w, k: the limits' middle -5 is not positive"),
        (
            ("w", "k", 10, -30, 31, 10, 0.99),
            r"w, k: no 10 positive values .* of 59\.\d+ means; the most is below 3\.162",
        ),
    ],
)
def test_limits_no_positive_values_have(row: tuple[object, ...], message: str) -> None:
    with pytest.raises(RefusalError, match=message):
        simulate_like(summary(row), seed=1)


def test_tied_scores_cannot_be_spread() -> None:
    with pytest.raises(RefusalError, match=r"cannot be spread that far\. Try another seed"):
        _match(np.array([0.0, 1.0, 1.0]), 1.0, 1.2, "w, k")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"subjects": 1}, r"subjects = 1: at least two subjects"),
        ({"seed": -4}, r"seed = -4: a seed is a whole number"),
    ],
)
def test_options_out_of_range(options: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulate_like(PUBLISHED, **({"seed": 1} | options))  # type: ignore[arg-type]


def test_means_and_sds_have_no_printed_limits() -> None:
    table = summary(
        ("a", "k", 1, 1, 0.1, 8),
        columns=["environment", "parameter", "reference", "mean", "sd", "n"],
    )
    with pytest.raises(
        UsageError, match=r"a, k: printed limits are needed.* percept fit takes means"
    ):
        simulate_like(table, seed=1)
