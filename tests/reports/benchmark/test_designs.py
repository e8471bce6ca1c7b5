"""Designs: the studies are those named, fits are measured, and the page says what the rows show."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from percept.checkpoint import plan_digest
from reports.benchmark.designs import STUDIES, Row, beside, by_nutpie, page, written
from reports.benchmark.simulated import DESIGNS, simulated

BENCHMARK = Path(__file__).resolve().parents[3] / "reports" / "benchmark"


def cell_means(study):
    """Return means and numbers of trials, subjects by environments."""
    shape = study.subjects, len(study.environment)
    cell = study.subject * shape[1] + study.cell
    counts = np.bincount(cell, minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        means = [np.bincount(cell, column, counts.size) / counts for column in study.response.T]
    return np.reshape(means, (-1, *shape)), counts.reshape(shape)


def test_an_irregular_study_misses_cells_and_repeats_others():
    _, counts = cell_means(simulated(DESIGNS["60x8-irregular"], 1))
    # A fifth of 480 cells, within four binomial SDs.
    assert abs((counts == 0).sum() - 96) < 4 * np.sqrt(480 * 0.2 * 0.8)
    assert sorted(set(counts[counts > 0])) == [1, 2, 3, 4]


def test_one_subject_is_three_times_off_and_the_others_are_not():
    design = DESIGNS["8x4x2-outlier"]
    off = simulated(design, 2)
    without = simulated(dataclasses.replace(design, outlier=1.0), 2)
    apart = off.response - without.response
    assert apart[off.subject == 0] == pytest.approx(np.full((8, 2), np.log(3.0)), rel=1e-12)
    assert np.abs(apart[off.subject > 0]).max() == 0.0


def test_scatter_between_subjects_vanishes_where_sigma_w_does():
    """Cell means about subjects' and environments' own scatter by the trials alone, sigma_e²/3."""
    study = simulated(DESIGNS["24x12x3-none"], 1)
    means, _ = cell_means(study)
    rest = means - means.mean(axis=2, keepdims=True) - means.mean(axis=1, keepdims=True)
    rest += means.mean(axis=(1, 2), keepdims=True)
    between = (rest**2).sum(axis=(1, 2)) / (23 * 11)
    within = study.response - means[:, study.subject, study.cell].T
    trials = (within**2).sum(axis=0) / (24 * 12 * 2) / 3
    # The ratio of variances of 253 and 576 degrees of freedom has a relative SD of about 0.11.
    assert between / trials == pytest.approx(np.ones(2), abs=0.45)


@pytest.mark.evidence
def test_a_fit_is_measured(tmp_path):
    """Two seconds of processor time: a fit to the default tolerance is what the page measures."""
    text = page(tmp_path, rows=("6x3x1", "subjects' own trial SDs, no factor"), seeds=1).text
    assert "2 of 2 fits pass the gate." in text
    assert "No limits are compared." in text
    row = next(line.split(" | ") for line in text.splitlines() if line.startswith("| 6x3x1"))
    assert 0.5 < float(row[2]) < 60.0
    assert float(row[6]) <= 0.01
    assert row[7] == "yes"


def fit_of(value, error, **more):
    return {"value": value, "error": error, "seconds": 60.0, "notes": more}


def test_limits_are_compared_in_combined_errors():
    row = Row("6x3x1", 1, 2.0, 3.0, 200.0, 300.0, 0.009, passed=True)
    ours = fit_of([1.0, 2.0], [0.3, 0.4])
    both = beside(row, ours, fit_of([1.5, 5.0], [0.4, 0.3], divergences=7.0))
    assert (both.nutpie, both.divergences, both.limits, both.far) == (60.0, 7.0, 2, 1)
    # Differences of 0.5 and 3 over errors of 0.5.
    assert both.farthest == pytest.approx(6.0, rel=1e-12)
    assert both.apart == pytest.approx(np.sqrt((1.0 + 36.0) / 2), rel=1e-12)
    assert both.times == pytest.approx((4 / 3 + 3 / 4) / 2, rel=1e-12)


def test_the_page_names_what_misses():
    one = Row("6x3x1", 1, 2.0, 3.0, 200.0, 300.0, 0.009, passed=True)
    compared = dataclasses.replace(one, apart=1.0, farthest=2.0, limits=30, far=0)
    other = dataclasses.replace(one, design="12x8x1", apart=2.0, farthest=3.5, limits=10, far=2)
    failed = dataclasses.replace(one, design="24x12x1", seed=2, passed=False)
    made = written([compared, other, failed])
    assert "2 of 3 fits pass the gate; not 24x12x1 (seed 2)." in made.text
    # 2 of 40, and sqrt((30·1 + 10·4)/40).
    assert "Of 40 limits 5.00% lie beyond 3 combined errors, the farthest at 3.50" in made.text
    assert "the root mean square is 1.32." in made.text
    assert not made.right


def test_what_nutpie_found_is_kept(tmp_path):
    plan = f"6x3x1 {plan_digest(STUDIES['6x3x1'])}"
    line = {"plan": plan, "index": 1} | fit_of([1.0], [0.1])
    (tmp_path / "finished.jsonl").write_text(json.dumps(line) + "\n", encoding="utf-8")
    assert by_nutpie("6x3x1", 1, tmp_path, sample=True) == fit_of([1.0], [0.1])
    assert by_nutpie("12x8x1", 1, tmp_path, sample=False) is None


def test_the_committed_runs_of_nutpie_are_of_these_designs():
    kept = [name for name in DESIGNS if by_nutpie(name, 1, BENCHMARK, sample=False)]
    assert kept == [name for name, design in DESIGNS.items() if design.peer]
