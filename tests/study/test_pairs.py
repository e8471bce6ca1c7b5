"""What a comparison of two studies says beside its numbers, and whom it refuses to divide."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study, read_sessions
from percept.errors import UsageError
from percept.sessions import ReadOptions, Sessions
from percept.study.compare import compare_studies, split_by
from tests import DATASETS


def sessions(prefix, *, trials=1, seed=0):
    rng = np.random.default_rng(seed)
    rows = [
        [f"{prefix}{s}", "VE1", 15.0, t, 15.0 * np.exp(0.1 * rng.standard_normal())]
        for s in range(5)
        for t in range(trials)
    ]
    return Sessions.from_frame(
        pd.DataFrame(rows, columns=["subject", "environment", "k_ref", "trial", "k_adj"])
    )


def study(which, **inference):
    return Study(which, Scene.from_tables({"inference": {"method": "classical", **inference}}))


def test_intervals_that_claim_different_shares_are_said_to():
    a = study(sessions("A"), share=0.99, confidence=0.95)
    b = study(sessions("B", seed=1), share=0.5, confidence=0.6)
    (note,) = compare_studies(a, b).notes
    assert note == (
        "Intervals of kind share hold 0.99 of users with confidence 0.95 and 0.5 of users with confidence "
        "0.6: their widths differ for that reason too."
    )
    assert compare_studies(a, study(sessions("B", seed=1), share=0.99, confidence=0.95)).notes == ()
    assert compare_studies(a, study(sessions("B", seed=1), share=0.5, kinds=["mean"])).notes == ()


def test_different_numbers_of_trials_are_said():
    (note,) = compare_studies(study(sessions("A", trials=3)), study(sessions("B", seed=1))).notes
    assert note.startswith(
        "Subjects typically made 3 trials of an environment in A and 1 in B: more of the trial noise"
    )


def scattered(prefix, centre, sd, count, seed):
    k = centre * np.exp(sd * np.random.default_rng(seed).standard_normal(count))
    subjects = [f"{prefix}{i}" for i in range(count)]
    table = pd.DataFrame({"subject": subjects, "environment": "VE1", "k_ref": 100.0, "k_adj": k})
    return study(Sessions.from_frame(table), level=0.9), np.log(k)


def test_limits_of_a_difference_are_welch_s_and_those_of_a_ratio_of_spreads_fisher_s():
    """Four subjects and nine, of four times the spread."""
    first, a = scattered("A", 100.0, 0.1, 4, seed=2)
    second, b = scattered("B", 120.0, 0.4, 9, seed=3)
    (row,) = compare_studies(first, second).differences.query("parameter == 'k'").itertuples()
    welch = stats.ttest_ind(b, a, equal_var=False).confidence_interval(0.9)
    np.testing.assert_allclose(np.log([row.lower, row.upper]), [welch.low, welch.high], rtol=1e-9)
    fisher = b.var(ddof=1) / a.var(ddof=1) / stats.f(8, 3).ppf([0.95, 0.05])
    np.testing.assert_allclose([row.spread_lower, row.spread_upper], np.sqrt(fisher), rtol=1e-9)


def test_published_limits_and_blank_groups_are_not_divided():
    table = read_sessions(DATASETS / "hbfd_table1.csv")
    with pytest.raises(UsageError, match="column 'environment': published limits hold no subjects to divide"):
        split_by(table, "environment")
    frame = sessions("A").table.assign(hand=["L", "R", "L", "", "R"])
    options = ReadOptions.from_mapping({"sessions": {"groups": ["hand"]}})
    whole = Sessions.from_frame(frame, options=options)
    with pytest.raises(UsageError, match=r"<frame>:5, column 'hand': 1 row without a value, of no group"):
        split_by(whole, "hand")
    # Of a part of the table the labels are those of the whole.
    some = dataclasses.replace(whole, table=whole.table.iloc[2:])
    with pytest.raises(UsageError, match=r"<frame>:5, column 'hand'"):
        split_by(some, "hand")
