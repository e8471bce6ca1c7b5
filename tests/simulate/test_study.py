"""Whole studies drawn from the model, and the tables they are written to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from percept.errors import RefusalError, UsageError
from percept.inference.hierarchy.priors import Priors
from percept.simulate import (
    Design,
    TrueValues,
    draw_hyperparameters,
    simulate,
    write_sessions,
)

REFERENCES = np.array([[10.0, 0.1], [1000.0, 1.0], [10000.0, 10.0]])
DESIGN = Design(REFERENCES, np.array([[1, 2, 0], [3, 1, 1]]), environments=("soft", "middle", "hard"))


@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_rows_are_the_responses_on_the_references(family: str) -> None:
    study = simulate(DESIGN, seed=3, family=family)  # type: ignore[arg-type]
    assert list(study.table.columns) == [
        *("subject", "session", "environment", "k_ref", "b_ref", "trial", "k_adj", "b_adj", "source")
    ]
    cells = list(zip(study.table["subject"], study.table["environment"], study.table["trial"], strict=True))
    assert cells == [
        ("S01", "soft", 1),
        ("S01", "middle", 1),
        ("S01", "middle", 2),
        ("S02", "soft", 1),
        ("S02", "soft", 2),
        ("S02", "soft", 3),
        ("S02", "middle", 1),
        ("S02", "hard", 1),
    ]
    for (_, row), y in zip(study.table.iterrows(), study.responses.y, strict=True):
        reference = dict(zip(DESIGN.environments, REFERENCES, strict=True))[row["environment"]]
        assert_array_equal((row["k_ref"], row["b_ref"]), reference)
        ratio = np.array([row["k_adj"], row["b_adj"]]) / reference
        assert_allclose(np.log(ratio) if family == "lognormal" else ratio - 1, y, rtol=1e-9, atol=1e-13)
    assert set(study.table["source"]) == {"simulated"}


def test_the_seed_is_the_only_randomness() -> None:
    pd.testing.assert_frame_equal(simulate(DESIGN, seed=7).table, simulate(DESIGN, seed=7).table)
    generator = np.random.default_rng(7)
    first, second = simulate(DESIGN, seed=generator), simulate(DESIGN, seed=generator)
    pd.testing.assert_frame_equal(first.table, simulate(DESIGN, seed=7).table)
    assert not np.any(first.responses.y == second.responses.y)


def test_what_is_given_is_held_fixed() -> None:
    truth = simulate(DESIGN, seed=1).truth
    again = simulate(DESIGN, seed=2, values=truth)
    assert again.truth is truth
    shared = simulate(DESIGN, seed=2, values=truth.hyper)
    assert shared.truth.hyper is truth.hyper
    assert not np.any(shared.truth.sigma == truth.sigma)


def test_priors_are_those_given() -> None:
    tight = Priors(alpha_sd=1e-9, gamma_sd=1e-9, tau_scale=1e-9, log_s_mean=-30, log_s_sd=0.01)
    assert np.abs(simulate(DESIGN, seed=1, priors=tight).truth.beta).max() < 1e-7
    assert np.abs(simulate(DESIGN, seed=1).truth.beta).max() > 1e-3


def test_one_parameter() -> None:
    design = Design.balanced([[10.0], [1000.0]], subjects=3, parameters=("k",))
    table = simulate(design, seed=1).table
    assert "b_adj" not in table
    assert len(table) == 6
    assert (table["k_adj"] > 0).all()


def test_wrong_arguments() -> None:
    hyper = draw_hyperparameters(DESIGN, Priors(), np.random.default_rng(1))
    with pytest.raises(UsageError, match="family = 'gamma': the family must be"):
        simulate(DESIGN, seed=1, family="gamma")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="priors have no use"):
        simulate(DESIGN, seed=1, values=hyper, priors=Priors())
    alone = Design.balanced([[10.0]], subjects=3, parameters=("k",))
    with pytest.raises(UsageError, match=r"alpha = \(2,\): .* 1 parameter"):
        simulate(alone, seed=1, values=hyper)
    truth = TrueValues(hyper, *(np.zeros((2, 2)) for _ in range(4)))
    with pytest.raises(UsageError, match=r"beta must have the shape \(3, 2\)"):
        simulate(DESIGN, seed=1, values=truth)


def test_values_no_double_can_hold() -> None:
    hyper = draw_hyperparameters(DESIGN, Priors(), np.random.default_rng(1))
    for beta in (1e4, -1e4):
        truth = TrueValues(hyper, np.zeros((3, 2)), np.full((3, 2), beta), np.ones((3, 2)), np.ones((3, 2)))
        with pytest.raises(RefusalError, match="leaves the range of doubles"):
            simulate(DESIGN, seed=1, values=truth)


def test_files_read_back_as_the_same_doubles(tmp_path: Path) -> None:
    table = simulate(DESIGN, seed=5).table
    path = write_sessions(table, tmp_path / "s.csv")
    back = pd.read_csv(path, dtype=str)
    for name in ("k_ref", "b_ref", "k_adj", "b_adj"):
        assert_array_equal(back[name].map(float), table[name])
    assert list(back["subject"]) == list(table["subject"])
    assert [entry.name for entry in tmp_path.iterdir()] == ["s.csv"]
    assert b"\r" not in path.read_bytes()


def test_files_say_what_they_are(tmp_path: Path) -> None:
    table = simulate(DESIGN, seed=5).table
    target = tmp_path / "s.csv"
    for wrong in (table.drop(columns="source"), table.assign(source="measured")):
        with pytest.raises(UsageError, match="must say 'simulated' in its column 'source'"):
            write_sessions(wrong, target)
    with pytest.raises(RefusalError, match=r"s\.csv, column 'k_adj': a simulated value is not finite"):
        write_sessions(table.assign(k_adj=np.inf), target)
    with pytest.raises(UsageError, match="the folder to write to does not exist"):
        write_sessions(table, tmp_path / "none" / "s.csv")
    assert not target.exists()
