"""Studies made like a published table: the limits exactly, the correlations as near as ten subjects allow."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from percept.errors import RefusalError, UsageError
from percept.simulate import (
    Correlations,
    realised_correlations,
    simulate_like,
    simulate_like_csv,
    write_sessions,
)
from percept.simulate.like import _match
from tests import DATASETS

TABLE1 = DATASETS / "hbfd_table1.csv"


def rows(*cells: tuple[object, ...]) -> pd.DataFrame:
    return pd.DataFrame(
        cells, columns=["environment", "parameter", "reference", "lower", "upper", "n", "level"]
    )


@pytest.mark.parametrize("seed", range(2, 12))
def test_any_seed_prints_as_table_1(seed: int, printed_limits) -> None:  # type: ignore[no-untyped-def]
    sessions = simulate_like_csv(TABLE1, seed=seed)
    assert (sessions[["k_adj", "b_adj"]] > 0).all(axis=None)
    for row in pd.read_csv(TABLE1, dtype=str).itertuples():
        values = sessions.loc[sessions["environment"] == row.environment, f"{row.parameter}_adj"]
        assert len(values) == 10
        limits = printed_limits(map(repr, values.tolist()), row.level, (row.lower, row.upper))
        assert limits == (row.lower, row.upper), (row.environment, row.parameter)


def test_same_seed_same_bytes_other_seed_other_values(tmp_path: Path) -> None:
    files = [
        write_sessions(simulate_like_csv(TABLE1, seed=seed), tmp_path / f"{i}.csv").read_bytes()
        for i, seed in enumerate((5, 5, 6))
    ]
    assert files[0] == files[1]
    assert files[0] != files[2]


@pytest.mark.parametrize(("between", "correlation"), [(0.4, 0.3), (0.0, -0.5), (0.8, 0.9)])
def test_correlations_as_stated(between: float, correlation: float) -> None:
    many = realised_correlations(
        simulate_like_csv(TABLE1, seed=3, subjects=4000, between=between, correlation=correlation)
    )
    # An average of correlations scatters less than one of them, whose standard error is (1 - r²)/√n.
    assert abs(many.within - correlation) < 4 * (1 - correlation**2) / math.sqrt(4000)
    assert abs(many.across - between) < 4 * (1 - between**2) / math.sqrt(4000)
    ten = realised_correlations(simulate_like_csv(TABLE1, seed=3, between=between, correlation=correlation))
    assert abs(ten.within - correlation) < (1 - correlation**2) / math.sqrt(9)
    assert abs(ten.across - between) < (1 - between**2) / math.sqrt(9)


def test_ten_subjects_are_the_nearest_of_many_draws_in_both_correlations() -> None:
    """A correlation of ten misses by some (1 - r²)/3, 0.17 and 0.32; the nearest of 200 draws by far less."""
    for seed in range(5):
        found = realised_correlations(simulate_like_csv(TABLE1, seed=seed, between=0.7, correlation=0.2))
        assert abs(found.across - 0.7) < 0.1
        assert abs(found.within - 0.2) < 0.1


def test_realised_correlations_pair_by_pair() -> None:
    sessions = simulate_like_csv(TABLE1, seed=9)
    logs = {
        (name, environment): np.log(group[f"{name}_adj"].to_numpy())
        for environment, group in sessions.groupby("environment")
        for name in ("k", "b")
    }
    names = sorted({environment for _, environment in logs})
    within = [np.corrcoef(logs["k", e], logs["b", e])[0, 1] for e in names]
    across = [
        np.corrcoef(logs[p, e], logs[p, f])[0, 1] for p in ("k", "b") for e in names for f in names if e < f
    ]
    assert len(across) == 20
    shuffled = sessions.sample(frac=1, random_state=1)
    found = realised_correlations(shuffled)
    assert_allclose((found.within, found.across), (np.mean(within), np.mean(across)), rtol=1e-12)


def test_more_subjects_keep_mean_and_sd() -> None:
    few, many = (simulate_like_csv(TABLE1, seed=1, subjects=n) for n in (10, 40))
    assert many["subject"].nunique() == 40
    for name in ("k_adj", "b_adj"):
        a, b = (table.groupby("environment")[name] for table in (few, many))
        assert_allclose(a.mean(), b.mean(), rtol=2e-5)
        assert_allclose(a.std(), b.std(), rtol=2e-4)


def test_one_parameter_in_one_environment() -> None:
    study = simulate_like(rows(("wall", "b", 2, 1.5, 2.5, 2, 0.9)), seed=4)
    assert list(study.columns) == ["subject", "session", "environment", "b_ref", "trial", "b_adj", "source"]
    assert study["b_adj"].mean() == pytest.approx(2.0, abs=0.05)
    assert realised_correlations(study) == Correlations(within=None, across=None)


@settings(max_examples=30, deadline=None)
@given(
    mean=st.floats(1e-3, 1e6),
    cv=st.floats(0.01, 1.5),
    n=st.integers(4, 30),
    seed=st.integers(0, 2**32 - 1),
)
def test_moments_are_matched_whatever_they_are(mean: float, cv: float, n: int, seed: int) -> None:
    z = np.random.default_rng(seed).standard_normal(n)
    values = _match(z, mean, cv * mean, "wall, k")
    assert values.min() > 0
    assert_allclose((values.mean(), values.std(ddof=1)), (mean, cv * mean), rtol=1e-10)
    assert list(np.argsort(values)) == list(np.argsort(z))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (("w", "k", 10, -30, 20, 10, 0.99), r"w, k: the limits' middle -5 is not positive"),
        (
            ("w", "k", 10, -30, 31, 10, 0.99),
            r"w, k: no 10 positive values .* of 59\.\d+ means; the most is below 3\.162",
        ),
        (
            ("w", "k", 10, "9.0000001", "11.0000001", 10, 0.99),
            r"digits: w, k: .* Ask for more digits",
        ),
    ],
)
def test_limits_no_positive_values_have(row: tuple[object, ...], message: str) -> None:
    with pytest.raises(RefusalError, match=message):
        simulate_like(rows(row), seed=1)


def test_more_digits_reproduce_a_finer_table() -> None:
    table = rows(("w", "k", 10, "9.0000001", "11.0000001", 10, 0.99))
    assert simulate_like(table, seed=1, digits=10)["k_adj"].mean() == pytest.approx(10.0000001, abs=1e-8)


def test_tied_scores_cannot_be_spread() -> None:
    with pytest.raises(RefusalError, match=r"cannot be spread that far\. Try another seed"):
        _match(np.array([0.0, 1.0, 1.0]), 1.0, 1.2, "w, k")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"subjects": 1}, r"subjects = 1: at least two subjects"),
        ({"between": 1.5}, r"between = 1\.5: between must lie in \[0, 1\]"),
        ({"correlation": -2}, r"correlation = -2: a correlation lies in \[-1, 1\]"),
        ({"digits": 0}, r"digits = 0: a double holds 1 to 15"),
        ({"seed": -4}, r"seed = -4: a seed is a whole number"),
    ],
)
def test_options_out_of_range(options: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulate_like_csv(TABLE1, **({"seed": 1} | options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: pd.concat([t, t]), r"column 'environment': a subject has two rows"),
        (lambda t: t.iloc[1:], r"every subject needs a positive value"),
        (lambda t: t.assign(b_adj=-t["b_adj"]), r"every subject needs a positive value"),
    ],
)
def test_correlations_need_a_full_grid(change, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(UsageError, match=message):
        realised_correlations(change(simulate_like_csv(TABLE1, seed=1)))


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(UsageError, match="taken: cannot be written: Is a directory"):
        write_sessions(simulate_like_csv(TABLE1, seed=1), tmp_path / "taken")


def test_only_simulated_files_are_written_over(tmp_path: Path) -> None:
    table = simulate_like_csv(TABLE1, seed=1)
    again = write_sessions(table, tmp_path / "again.csv")
    first = again.read_bytes()
    write_sessions(simulate_like_csv(TABLE1, seed=2), again)
    assert again.read_bytes() != first
    measured = table.drop(columns="source").to_csv(index=False)
    for text in (
        measured,
        table.assign(source="lab").to_csv(index=False),
        "",
        "subject,source\n",
        "\x00\x01",
    ):
        taken = tmp_path / "taken.csv"
        taken.write_text(text)
        with pytest.raises(
            UsageError, match=r"taken\.csv: is there already, and was not simulated\. .*another name"
        ):
            write_sessions(table, taken)
        assert taken.read_text() == text
