"""Designs: the studies are those named, results are kept, and the summary says what the rows
show."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from percept.errors import UsageError
from reports.benchmark.__main__ import main
from reports.benchmark.designs import DesignCost, design_costs, summary
from reports.benchmark.simulated import DESIGNS, simulated


def statistics_of(study):
    return study.trials.statistics


BENCHMARK = Path(__file__).resolve().parents[3] / "reports" / "benchmark"


def test_an_irregular_study_misses_cells_and_repeats_others():
    statistics = statistics_of(simulated(DESIGNS["60x8-irregular"], 1))
    present = np.isfinite(statistics.cell_means).all(axis=1)
    # A fifth of 480 cells, within four binomial SDs.
    assert abs((~present).sum() - 96) < 4 * np.sqrt(480 * 0.2 * 0.8)
    trials = np.concatenate([pattern.trials for pattern in statistics.patterns])
    assert sorted(set(trials)) == [1, 2, 3, 4]


def test_one_subject_is_three_times_off_and_the_others_are_not():
    design = DESIGNS["8x4x2-outlier"]
    without = dataclasses.replace(design, outlier=1.0)
    means, means_without = (
        statistics_of(simulated(each, 2)).cell_means for each in (design, without)
    )
    off = means - means_without
    assert off[0] == pytest.approx(np.full((2, 4), np.log(3.0)), rel=1e-12)
    assert np.abs(off[1:]).max() < 1e-14


def test_scatter_between_subjects_vanishes_where_sigma_w_does():
    """Cell means about subjects' and environments' own scatter by the trials alone, sigma_e²/3."""
    statistics = statistics_of(simulated(DESIGNS["24x12x3-none"], 1))
    means = statistics.cell_means
    rest = (
        means
        - means.mean(axis=2, keepdims=True)
        - means.mean(axis=0)
        + means.mean(axis=(0, 2))[:, None]
    )
    between = (rest**2).sum(axis=(0, 2)) / (23 * 11)
    trials = (statistics.trial_rows**2).sum(axis=(1, 2)) / statistics.trial_df.sum() / 3
    # The ratio of variances of 253 and 576 degrees of freedom has a relative SD of about 0.11.
    assert between / trials == pytest.approx(np.ones(2), abs=0.45)


def test_levels_of_factors_share_a_reference_and_a_covariate_varies_by_trial():
    study = simulated(DESIGNS["16x5x2x2-covariate"], 1)
    assert len(study.model.cells) == 2 * 5 * 2
    assert len(np.unique(study.trials.statistics.x[0])) == 5


@pytest.mark.evidence
def test_a_fit_is_measured_kept_and_not_measured_again(tmp_path, capsys):
    """Two seconds of processor time: a fit to the default tolerance is what the part measures."""
    command = [
        "designs",
        "--rows",
        "6x3x1",
        "--seeds",
        "1",
        "--no-peer",
        "--out",
        str(tmp_path),
    ]
    assert main(command) == 0
    assert "6x3x1, seed 1: fit" in capsys.readouterr().err
    kept = (tmp_path / "finished.jsonl").read_text()
    assert kept.count("\n") == 1
    assert main(command) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-1] == str(tmp_path / "designs.md")
    assert "seed 1: fit" not in printed.err
    assert (tmp_path / "finished.jsonl").read_text() == kept
    written = json.loads((tmp_path / "designs.json").read_text())
    (row,) = written["rows"]
    assert row["passed"]
    assert row["in_time"] == (row["processor_s"] <= row["allowed_s"])
    assert row["in_wall_time"] == (row["wall_s"] <= row["allowed_s"])
    assert row["coordinates"] == 18
    assert row["worst_error"] <= 0.01
    page = (tmp_path / "designs.md").read_text()
    assert "`python -m reports.benchmark designs --rows 6x3x1 --seeds 1 --no-peer --out " in page
    assert "1 of 1 fits pass the gate." in page
    assert "Nutpie has not run, or gave no limits to compare, on 6x3x1." in page


def test_an_unknown_design_is_named():
    with pytest.raises(
        UsageError, match=r"--rows.*'7x7x7': no such design; there are 6x3x1, 12x8x1"
    ):
        design_costs(["7x7x7"])


def cost(name, **changes):
    row = DesignCost(
        name, 1, 10.0, True, True, 5.0, 5.0, 20, 300, 10.0, 1.001, 0.009, True, "", 200.0
    )
    return dataclasses.replace(row, **changes)


def test_the_summary_names_what_misses():
    compared = {"peer_s": 1.0, "peer_error": 0.5, "z_beyond_3": 0, "z_largest": 2.0, "compared": 30}
    rows = [
        cost("6x3x1", z_square=1.0, **compared),
        cost(
            "12x8x1",
            z_square=4.0,
            **(compared | {"compared": 10, "z_beyond_3": 2, "peer_error": 1.5}),
        ),
        cost(
            "24x12x1",
            in_time=False,
            in_wall_time=False,
            wall_s=3600.0,
            processor_s=25.0,
            passed=False,
            peak_mb=1200.0,
            peer_s=600.0,
        ),
    ]
    passing, timely, memory, on_wall, together, peer, coarse, without = summary(rows)
    assert passing == "2 of 3 fits pass the gate; not 24x12x1 (seed 1)."
    assert timely == "2 of 3 fits end within their time by processor time; not 24x12x1 (seed 1)."
    assert on_wall.startswith("By wall time, 2 of 3 fits end within their time")
    # 5 + 5 + 3600, 5 + 5 + 25, and 1 + 1 + 600.
    assert together.startswith(
        "Together the fits took 3,610 s of wall time and 35 s of processor time, and nutpie's"
        " sampling 602 s."
    )
    assert memory == "2 of 3 fits stay below 1 GB of memory; not 24x12x1 (seed 1)."
    # sqrt((30·1 + 10·4)/40) and 2/40.
    assert "40 limits of kinds mean and user" in peer
    assert "a root mean square of 1.32; 5.00% exceed 3; the largest is 2.00." in peer
    assert coarse == "Nutpie's own error exceeds percept's in 12x8x1."
    assert without == "Nutpie has not run, or gave no limits to compare, on 24x12x1."


def test_the_committed_page_says_which_clock():
    rows = json.loads((BENCHMARK / "designs.json").read_text(encoding="utf-8"))["rows"]
    page = (BENCHMARK / "designs.md").read_text(encoding="utf-8")
    by_wall = sum(row["wall_s"] <= row["allowed_s"] for row in rows)
    by_processor = sum(row["processor_s"] <= row["allowed_s"] for row in rows)
    assert f"{by_processor} of {len(rows)} fits end within their time by processor time" in page
    assert f"By wall time, {by_wall} of {len(rows)} fits end within their time" in page
    assert f"Together the fits took {sum(row['wall_s'] for row in rows):,.0f} s of wall" in page
