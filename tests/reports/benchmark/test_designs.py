"""Designs: the studies are those named."""

import dataclasses

import numpy as np
import pytest

from reports.benchmark.simulated import DESIGNS, simulated


def test_an_irregular_study_misses_cells_and_repeats_others():
    study = simulated(DESIGNS["60x8-irregular"], 1)
    counts = np.bincount(8 * study.subject + study.cell, minlength=480)
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
