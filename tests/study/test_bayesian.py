"""What the hierarchical model is given, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from percept import Scene, read_sessions
from percept.sessions import Sessions
from percept.study.fit import prepare
from tests import DATASETS
from tests.study.checked import table_of


def test_a_step_counts_relative_to_where_the_subjects_adjusted() -> None:
    """All set 2000 N/m at a reference of 1000: a step of 10 is one of 10/2000, uniform within."""
    table = table_of(("k", "b"), subjects=4)
    table.loc[table["environment"] == "VE2", "k_adj"] = 2000.0
    scene = Scene.from_tables({"model": {"resolution": {"k": 10.0, "b": 0.1}}})
    found = prepare(Sessions.from_frame(table), scene, ("k", "b")).model.density.resolution
    np.testing.assert_allclose(found.between, [[0, (10 / 2000) ** 2 / 12, 0], [0, 0, 0]], rtol=1e-12)


@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_published_limits_are_taken_back_to_means_and_sds(family: str) -> None:
    """Relative to the reference, or moments of the logarithm: t limits at 99 %, ten subjects."""
    sessions = read_sessions(DATASETS / "hbfd_table1.csv")
    scene = Scene.from_tables({"inference": {"family": family}})
    models = prepare(sessions, scene, ("k", "b")).model.models
    for model, parameter in zip(models, "kb", strict=True):
        rows = sessions.table[sessions.table["parameter"] == parameter]
        lower, upper, reference = (rows[name].to_numpy(float) for name in ("lower", "upper", "reference"))
        mean = 0.5 * (lower + upper) / reference
        sd = 0.5 * (upper - lower) / stats.t.isf(0.005, 9) * np.sqrt(10) / reference
        log_sd = np.sqrt(np.log1p((sd / mean) ** 2))
        centre, wanted = (mean - 1.0, sd) if family == "normal" else (np.log(mean) - 0.5 * log_sd**2, log_sd)
        statistics = model.density.statistics
        np.testing.assert_allclose(statistics.sd[0], wanted, rtol=1e-9)
        found = [pattern.mean[0, 0] for pattern in statistics.patterns]
        np.testing.assert_allclose(found, centre, rtol=1e-9, atol=1e-12)
