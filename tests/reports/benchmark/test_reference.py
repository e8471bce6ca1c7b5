"""The stored reference: what pooling does, what it is measured by, and that a new run agrees
with it."""

import json

import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from reports.benchmark.reference import (
    TOLERANCE,
    Reference,
    page,
    stored_reference,
    study_of,
)
from reports.fitted import by_percept


@pytest.fixture(scope="module")
def stored():
    return stored_reference("published")


def rows(seed, sd):
    rng = np.random.default_rng(seed)
    return [
        {
            "value": rng.normal(1.0, sd, (2, 2, 10)),
            "error": np.full((2, 2, 10), 0.1),
        }
        for _ in range(25)
    ]


def test_pooled_runs_are_averaged_and_their_errors_divided():
    found = Reference.pooled(rows(5, 0.1))
    assert found.error == pytest.approx(np.full((2, 2, 10), 0.02), rel=1e-12)
    # 40 means with standard error 0.02; 40 · 24 degrees of freedom behind the scatter.
    assert np.mean(((found.value - 1.0) / 0.02) ** 2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / 40))
    assert found.scatter == pytest.approx(1.0, abs=5 * np.sqrt(0.5 / (40 * 24)))


def test_runs_that_claim_too_much_scatter_more():
    assert Reference.pooled(rows(6, 0.3)).scatter == pytest.approx(
        3.0, abs=3 * 5 * np.sqrt(0.5 / (40 * 24))
    )


def test_the_stored_reference_claims_what_its_runs_show(stored):
    assert stored.scatter < 1.5


def test_a_short_run_agrees_with_the_stored_reference(stored):
    found = by_percept(study_of("published"), 0.05, 71)
    error = np.hypot(found.error, stored.error)
    worst = stats.norm.isf(0.5 * 1e-4 / found.value.size)
    assert np.abs((found.value - stored.value) / error).max() < worst
    assert 0.0 < stored.relative_error(found.value) < 0.05


def test_relative_error_is_in_half_widths(stored):
    half_width = 0.5 * (stored.value[:, 1:] - stored.value[:, :1])
    moved = stored.value + 0.03 * half_width
    assert stored.relative_error(moved) == pytest.approx(0.03, rel=1e-12)


def test_a_study_without_reference_is_refused(tmp_path):
    with pytest.raises(RefusalError, match=r"there are no reference limits of this study") as no:
        stored_reference("6x3x1")
    assert "python -m reports reference --out" in str(no.value)
    with pytest.raises(RefusalError, match="there are no reference limits"):
        stored_reference("published", tmp_path / "reference.json")


def test_the_command_goes_on_from_what_is_there(tmp_path, stored):
    """A folder that holds enough runs gives the reference without sampling."""
    kept = {"value": stored.value.tolist(), "error": stored.error.tolist()}
    lines = [
        json.dumps({"plan": f"published-k {TOLERANCE}", "index": index} | kept)
        for index in range(2)
    ]
    (tmp_path / "finished.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    made = page(tmp_path, studies=("published-k",), runs=2)
    assert "| published-k | 0 | " in made.text
    found = stored_reference("published-k", tmp_path / "reference.json")
    assert found.value.tolist() == stored.value.tolist()
