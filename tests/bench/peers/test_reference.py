"""The stored reference: what pooling does, what it is measured by, and that a new run agrees with it."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from percept.bench.peers.engines import percept_model
from percept.bench.peers.reference import LongRun, Reference, make_reference, stored_reference
from percept.errors import RefusalError
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from percept.report.plain import plain


@pytest.fixture(scope="module")
def stored(sessions):
    return stored_reference(hashlib.sha256(Path(sessions).read_bytes()).hexdigest())


def test_pooled_runs_are_averaged_and_their_errors_divided():
    rng = np.random.default_rng(5)
    rows = [
        {"value": rng.normal(1.0, 0.1, (3, 2, 10)), "error": np.full((3, 2, 10), 0.1), "effective": 100.0}
        for _ in range(25)
    ]
    found = LongRun.pooled(rows)
    assert found.effective == 2500.0
    assert found.error == pytest.approx(np.full((3, 2, 10), 0.02), rel=1e-12)
    # 60 means with standard error 0.02; 60 · 24 degrees of freedom behind the scatter.
    assert np.mean(((found.value - 1.0) / 0.02) ** 2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / 60))
    assert found.scatter == pytest.approx(1.0, abs=5 * np.sqrt(0.5 / (60 * 24)))


def test_runs_that_claim_too_much_scatter_more():
    rng = np.random.default_rng(6)
    rows = [
        {"value": rng.normal(0.0, 0.3, (3, 2, 10)), "error": np.full((3, 2, 10), 0.1), "effective": 1.0}
        for _ in range(25)
    ]
    assert LongRun.pooled(rows).scatter == pytest.approx(3.0, abs=3 * 5 * np.sqrt(0.5 / (60 * 24)))


def test_stored_reference_comes_from_two_samplers_that_agree(stored):
    assert stored.own.effective >= 1e6
    assert stored.other.effective >= 1e5
    apart = np.abs(stored.apart)
    # The largest of 60 normal differences stays below this in 999 of 1000 cases.
    assert apart.max() < stats.norm.isf(0.5 * 1e-3 / apart.size)
    assert stored.own.scatter < 1.5
    assert stored.other.scatter < 1.5


def test_a_short_run_agrees_with_the_stored_reference(sessions, stored):
    model, estimands = percept_model(sessions)
    assert estimands.cells == stored.cells
    run = sample(model, estimands, Settings(tolerance=0.05, seed=71))
    value = run.estimates.value.reshape(stored.own.value.shape)
    error = np.hypot(run.errors.reshape(value.shape), stored.own.error)
    assert np.abs((value - stored.own.value) / error).max() < stats.norm.isf(0.5 * 1e-4 / value.size)
    assert 0.0 < stored.relative_error(value) < 0.05


def test_relative_error_is_in_half_widths(stored):
    moved = stored.own.value + 0.03 * stored.half_width
    assert stored.relative_error(moved) == pytest.approx(0.03, rel=1e-12)


def test_reference_survives_json(stored):
    back = Reference.of_json(json.loads(json.dumps(plain(stored))))
    assert plain(back) == plain(stored)
    assert np.array_equal(back.own.value, stored.own.value)


def test_reference_of_another_file_is_refused():
    with pytest.raises(RefusalError, match="belong to another session file"):
        stored_reference("0" * 64)


def test_finished_runs_are_not_run_again(tmp_path, sessions, stored):
    """A folder that holds enough runs gives the reference without sampling, the same every time."""
    rows = {
        name: [{"value": run.value.tolist(), "error": run.error.tolist(), "effective": 60.0}] * 2
        for name, run in (("own", stored.own), ("other", stored.other))
    }
    for name, found in rows.items():
        text = "".join(json.dumps(row) + "\n" for row in found)
        (tmp_path / f"{name}-{'a' * 12}.jsonl").write_text(text, encoding="utf-8")
    lines = []
    found = make_reference(
        sessions, "a" * 64, tmp_path, command="x", own_effective=100, other_effective=100, log=lines.append
    )
    assert lines[-1] == "own: run 2, 120 of 100 effective draws"
    assert np.array_equal(found.own.value, stored.own.value)
    assert found.own.runs == 2
