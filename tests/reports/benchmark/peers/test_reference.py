"""The stored reference: what pooling does, what it is measured by, and that a new run agrees
with it."""

import json
import shutil

import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from reports.benchmark.peers import reference
from reports.benchmark.peers.engines import percept_run, study_of
from reports.benchmark.peers.reference import Reference, make_references, stored_reference
from tests import BENCHMARK


@pytest.fixture(scope="module")
def stored():
    return stored_reference(BENCHMARK, "published")


def rows(seed, sd):
    rng = np.random.default_rng(seed)
    return [
        {
            "value": rng.normal(1.0, sd, (3, 2, 10)),
            "error": np.full((3, 2, 10), 0.1),
            "effective": 100.0,
        }
        for _ in range(25)
    ]


def test_pooled_runs_are_averaged_and_their_errors_divided():
    found = Reference.pooled(rows(5, 0.1))
    assert found.effective == 2500.0
    assert found.error == pytest.approx(np.full((3, 2, 10), 0.02), rel=1e-12)
    # 60 means with standard error 0.02; 60 · 24 degrees of freedom behind the scatter.
    assert np.mean(((found.value - 1.0) / 0.02) ** 2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / 60))
    assert found.scatter == pytest.approx(1.0, abs=5 * np.sqrt(0.5 / (60 * 24)))


def test_runs_that_claim_too_much_scatter_more():
    assert Reference.pooled(rows(6, 0.3)).scatter == pytest.approx(
        3.0, abs=3 * 5 * np.sqrt(0.5 / (60 * 24))
    )


def test_the_stored_reference_claims_what_its_runs_show(stored):
    assert stored.effective >= 1e6
    assert stored.scatter < 1.5


def test_a_short_run_agrees_with_the_stored_reference(stored):
    found = percept_run(study_of("published"), 0.05, 71)
    error = np.hypot(found.error, stored.error)
    worst = stats.norm.isf(0.5 * 1e-4 / found.value.size)
    assert np.abs((found.value - stored.value) / error).max() < worst
    assert 0.0 < stored.relative_error(found.value) < 0.05


def test_relative_error_is_in_half_widths(stored):
    moved = stored.value + 0.03 * stored.half_width
    assert stored.relative_error(moved) == pytest.approx(0.03, rel=1e-12)


def test_a_study_without_reference_is_refused(tmp_path):
    with pytest.raises(
        RefusalError, match=r"reference\.json has no reference limits of this study"
    ) as refused:
        stored_reference(BENCHMARK, "nobody's")
    assert "Copy reports/benchmark/reference.json" in str(refused.value)
    with pytest.raises(RefusalError, match="has no reference limits"):
        stored_reference(tmp_path, "published")


def test_reference_command_goes_on_from_what_is_there(tmp_path, stored):
    """A folder that holds enough runs gives the reference without sampling."""
    kept = {"value": stored.value.tolist(), "error": stored.error.tolist(), "effective": 6e5}
    lines = [
        json.dumps({"plan": f"published-k {reference._TOLERANCE}", "index": index} | kept)
        for index in range(2)
    ]
    shutil.copy(BENCHMARK / "reference.json", tmp_path)
    (tmp_path / "finished.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    path = make_references(tmp_path, ("published-k",), runs=2)
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["published-k"]["effective"] == 1.2e6
    assert found["published-k"]["value"] == found["published"]["value"] == stored.value.tolist()
