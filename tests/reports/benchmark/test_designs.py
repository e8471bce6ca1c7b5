"""Designs: the studies are those named, fits are measured, and the page says what the rows show."""

import dataclasses

import numpy as np
import pytest

from reports.benchmark.simulated import DESIGNS, simulated


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
