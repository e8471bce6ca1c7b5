"""Designs: what they derive, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from percept.errors import UsageError
from percept.simulate import Design

TWO = [[10.0, 0.1], [1000.0, 1.0]]


def test_decades_are_centred_on_the_geometric_mean() -> None:
    design = Design.balanced([[10.0, 0.1], [1000.0, 1.0], [100000.0, 100.0]], subjects=3)
    assert_allclose(design.decades, [[-2, -4 / 3], [0, -1 / 3], [2, 5 / 3]], rtol=1e-14, atol=1e-15)


def test_names_and_counts() -> None:
    design = Design.balanced(TWO, subjects=120, trials=2)
    assert design.subjects[0] == "S001"
    assert design.subjects[-1] == "S120"
    assert Design.balanced(TWO, subjects=3).subjects == ("S01", "S02", "S03")
    assert design.environments == ("VE1", "VE2")
    assert design.repeated
    assert not Design.balanced(TWO, subjects=3).repeated
    assert_array_equal(design.trials, 2)


def test_the_design_keeps_its_own_copy() -> None:
    references, trials = np.array(TWO), np.ones((3, 2), dtype=int)
    design = Design(references, trials)
    references[0, 0], trials[0, 0] = 99.0, 99
    assert design.references[0, 0] == 10.0
    assert design.trials[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        design.references[0, 0] = 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parameters": ("b", "k")}, r"parameters must be \('k', 'b'\)"),
        ({"parameters": ("k",)}, r"one row per environment and 1 column"),
        ({"references": [10.0, 1000.0]}, r"one row per environment and 2 column"),
        (
            {"references": [[10.0, 0.0], [1000.0, 1.0]]},
            r"references = 0\.0: every reference must be positive",
        ),
        (
            {"references": [[10.0, np.nan], [1000.0, 1.0]]},
            r"references = nan: every reference must be positive",
        ),
        ({"trials": np.ones((3, 3), dtype=int)}, r"one row per subject and 2 column"),
        ({"trials": np.ones((0, 2), dtype=int)}, r"one row per subject and 2 column"),
        ({"trials": np.array([[1, -1], [1, 1]])}, r"whole numbers, none negative"),
        ({"trials": np.array([[1.0, 1.5], [1, 1]])}, r"whole numbers, none negative"),
        ({"trials": np.array([[1, 1], [0, 0]])}, r"subject number 2 has no trial"),
        ({"trials": np.array([[1, 0], [1, 0]])}, r"environment number 2 has no trial"),
        ({"environments": ("A", "A")}, r"environments must be 2 different names"),
        ({"environments": ("A",)}, r"environments must be 2 different names"),
    ],
)
def test_refused(changes: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"references": TWO, "trials": np.ones((3, 2), dtype=int)} | changes
    with pytest.raises(UsageError, match=message):
        Design(**arguments)  # type: ignore[arg-type]


def test_no_subjects() -> None:
    with pytest.raises(UsageError, match="at least one subject"):
        Design.balanced(TWO, subjects=0)
