"""Classical against Bayesian intervals, with the reasons in numbers."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from arviz_stats.base import array_stats

from percept import Scene, Study
from percept.inference.hierarchy.models import IntervalEstimands, Pooled
from percept.inference.hierarchy.wider_priors import reweighted, wider, with_priors
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from percept.sessions import Sessions
from percept.study.boundaries import compare_methods
from percept.study.intervals import cell_moments
from percept.study.methods import compare_intervals, prior_pull
from tests.study.checked import study_of, table_of


def test_the_reasons_multiply_to_the_ratio_of_widths(fitted: Study) -> None:
    table = fitted.comparison
    assert table is not None
    assert len(table) == 30
    logs = {m: np.log(table[f"upper_{m}"] / table[f"lower_{m}"]) for m in ("classical", "bayesian")}
    np.testing.assert_allclose(
        table["spread_ratio"] * table["certainty_ratio"], logs["bayesian"] / logs["classical"], rtol=1e-9
    )
    assert table["overlap"].between(0.0, 1.0).all()
    mean = table[table["kind"] == "mean"]
    assert (mean["to_mean_classical"] == 1.0).all()
    user = table[table["kind"] == "user"]
    np.testing.assert_allclose(user["to_mean_classical"], np.sqrt(11.0), rtol=1e-9)


def test_signs_and_units_of_the_comparison_by_hand(fitted: Study) -> None:
    """Shifts point from the classical centre to the Bayesian, and the other family's width is on top."""
    table, intervals = fitted.comparison, fitted.intervals
    assert table is not None
    keys = ["environment", "parameter", "kind"]
    marginal = intervals[(intervals["method"] == "classical") & (intervals["joint"] == "marginal")]
    marginal = marginal.assign(width=marginal["upper"] - marginal["lower"])
    width = marginal.pivot_table(index=keys, columns="family", values="width")
    for row in table.itertuples():
        at = width.loc[(row.environment, row.parameter, row.kind)]
        assert row.scale_ratio == pytest.approx(at["normal"] / at["lognormal"])
        of_cell = fitted.sessions.table["environment"] == row.environment
        sd = np.log(fitted.sessions.table.loc[of_cell, f"{row.parameter}_adj"]).std()
        classical, bayesian = (
            0.5 * np.log(getattr(row, f"lower_{m}") * getattr(row, f"upper_{m}"))
            for m in ("classical", "bayesian")
        )
        assert row.shift_sds == pytest.approx((bayesian - classical) / sd, abs=1e-9)


def test_intervals_apart_do_not_overlap(fitted: Study) -> None:
    assert fitted.fit is not None
    table = fitted.intervals
    table.loc[table["method"] == "bayesian", ["lower", "upper", "estimate"]] *= 1e9
    cells = cell_moments(fitted.sessions, ("k", "b"), "lognormal")
    found = compare_intervals(table, fitted.fit, fitted.scene.inference, cells)
    assert (found["overlap"] == 0.0).all()


def test_spreads_of_the_normal_family_are_compared_in_native_units() -> None:
    """References over two decades: a ratio of SDs, both in N/m."""
    study = study_of(table_of(subjects=6), method="both", family="normal", tolerance=0.2)
    assert study.comparison is not None
    assert study.fit is not None
    sd = study.sessions.table.groupby("environment")["k_adj"].std()
    model = study.fit.model
    spread = model.laws(study.fit.points).population_sd
    for row in study.comparison.itertuples():
        at = np.log(spread[:, model.cells.index(("k", row.environment))])
        typical = np.exp(at.mean()) * study.reference["k", row.environment]
        # Over all kept draws there, over some nearly independent ones of them here.
        error = 4.0 * at.std() / np.sqrt(len(at))
        assert np.log(row.spread_ratio * sd[row.environment] / typical) == pytest.approx(0.0, abs=error)


def test_priors_against_the_data_pull_towards_themselves() -> None:
    """All adjust half a neper too high, and the priors expect no bias: they pull both ends down."""
    study = study_of(
        table_of(subjects=6, alpha=0.5, tau=0.0, sigma_u=0.0, s=0.1),
        model={"priors": {"alpha_sd": 0.1, "tau_scale": 0.05}},
        method="both",
        tolerance=0.1,
    )
    assert study.comparison is not None
    mean = study.comparison.query("kind == 'mean'")
    assert (mean[["prior_lower", "prior_upper"]] < 0).all(axis=None)


def test_prior_pull_by_reweighting_agrees_with_a_refit(fitted: Study) -> None:
    assert fitted.fit is not None
    found = prior_pull(fitted.fit, fitted.scene.inference)
    assert found is not None
    model = fitted.fit.model
    assert isinstance(model, Pooled)
    wide = Pooled(with_priors(model.density, wider(model.density.priors)))
    run = sample(wide, IntervalEstimands(wide), Settings(tolerance=0.05, seed=9))
    assert found.effective > 1000
    for i, kind in enumerate(("mean", "user", "share")):
        lower, upper = run.estimates.value.reshape(3, 2, -1)[i]
        # Both are good to tolerances of .05 at least, and an endpoint of a mixture of 1500 draws to .01.
        off = np.abs([found.limits[kind][0] - lower, found.limits[kind][1] - upper]) / (0.5 * (upper - lower))
        assert off.max() < 4 * 0.05


def test_prior_pull_where_the_priors_matter() -> None:
    """Four subjects, three environments: weights of finite variance, and the limits of a refit."""
    rng = np.random.default_rng(1)
    reference = np.array([100.0, 2000.0, 30000.0])
    response = 0.15 * rng.normal(size=3) + 0.2 * rng.normal(size=(4, 1)) + 0.2 * rng.normal(size=(4, 3))
    rows = [
        {"subject": f"S{i}", "environment": f"E{j}", "k_ref": reference[j], "k_adj": reference[j] * np.exp(y)}
        for (i, j), y in np.ndenumerate(response)
    ]
    scene = Scene.from_tables({"inference": {"method": "bayesian", "tolerance": 0.01}})
    study = Study(Sessions.from_frame(pd.DataFrame(rows)), scene)
    assert study.fit is not None
    model = study.fit.model
    assert isinstance(model, Pooled)
    log_weight, _ = reweighted(model.density, study.fit.points)
    # Taken as log likelihoods, of which leaving one out takes the inverse. A fitted index errs by some .1.
    assert array_stats.psislw(-log_weight)[1] < 0.36 + 0.15
    found = prior_pull(study.fit, scene.inference)
    assert found is not None
    wide = Pooled(with_priors(model.density, wider(model.density.priors)))
    run = sample(wide, IntervalEstimands(wide), Settings(tolerance=0.01, seed=9))
    for i, kind in enumerate(("mean", "user", "share")):
        lower, upper = run.estimates.value.reshape(3, 2, -1)[i]
        error = np.hypot(0.01, 0.01 * np.sqrt(1500.0 / found.effective))
        off = np.abs([found.limits[kind][0] - lower, found.limits[kind][1] - upper]) / (0.5 * (upper - lower))
        assert off.max() < 4 * np.hypot(error, 0.01)
        kept = study.fit.run.estimates.value.reshape(3, 2, -1)[i]
        off = np.abs(np.array(found.own[kind]) - kept) / (0.5 * (kept[1] - kept[0]))
        assert off.max() < 4 * np.hypot(0.01, 0.01)


def test_curves_are_compared_in_pairs(fitted: Study) -> None:
    boundaries = fitted.boundaries_at(np.geomspace(0.1, 100.0, 15), ("VE3",))
    table = compare_methods(boundaries)
    assert len(table) == 6 * 2 + 2 + 2
    assert (table["area_lower"] <= table["largest_lower"].abs() + 1e-12).all()


def test_tables_are_the_caller_s_own(fitted: Study) -> None:
    """What is changed in a table asked for changes nothing of the study."""
    for name in ("intervals", "comparison", "curve_comparison"):
        before = getattr(fitted, name)
        changed = getattr(fitted, name)
        changed.iloc[:, 0] = "changed"
        pd.testing.assert_frame_equal(getattr(fitted, name), before)
