"""Bayesian contrasts of conditions within subjects: the model a study builds, and what it reports."""

import numpy as np
import pytest

from percept.study.basics import Skipped, results
from percept.study.contrasts import contrast_rows, within_model
from tests import LONG
from tests.documents import build_document, page_of
from tests.study.within import frame, study


@pytest.fixture(scope="module")
def made():
    table = frame(subjects=30, trials=1)
    return study(table[(table["subject"] != "S3") | (table["environment"] != "VE2")])


@pytest.fixture(scope="module")
def rows(made):
    scene = made.scene.with_inference(tolerance=0.05, method="bayesian")
    return list(contrast_rows(made.sessions, ("k",), scene))


@pytest.fixture(scope="module")
def computed(rows):
    return results(rows)


def test_the_model_has_a_cell_for_each_reference_and_level(made):
    model = within_model(made.sessions, "k", made.scene, ("left", "right"))
    assert model.statistics.environments == made.parts.environments
    assert model.reference.tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_allclose(model.statistics.x[0], [-1, -1, 0, 0, 1, 1], atol=1e-12)
    # Missing cells of a subject stay missing.
    gaps = np.isnan(model.statistics.cell_means[:, 0])
    assert gaps.sum() == 2
    assert gaps[3, 2:4].all()


def test_many_subjects_leave_little_to_the_priors(made, computed):
    """Limits of both methods' average user lie within a fifth of the classical half-width."""
    classical = made.parts.contrasts.query("of == 'bias' and kind == 'mean'").to_dict("records")
    bayesian = [row for row in computed if row["kind"] == "mean"]
    assert [row["environment"] for row in bayesian] == ["VE1", "VE2", "VE3", None]
    assert [row["n"] for row in bayesian] == [30, 29, 30, 30]
    c, b = classical[0], bayesian[0]
    half = np.log(c["upper"] / c["lower"]) / 2.0
    for end in ("lower", "estimate", "upper"):
        assert abs(np.log(b[end] / c[end])) < 0.2 * half
    assert "probability under the model and its priors" in b["covers"]


def test_spreads_are_quantiles_that_hold_one(computed):
    spreads = [row for row in computed if row["of"] == "spread"]
    # The overall ratio is not printed: the model shares the subject effect between levels.
    assert [row["environment"] for row in spreads] == ["VE1", "VE2", "VE3"]
    # Both levels have one law.
    assert all(row["lower"] < 1.0 < row["upper"] for row in spreads)
    assert all(row["lower"] < row["estimate"] < row["upper"] for row in spreads)


def test_the_overall_ratio_of_spreads_is_named_as_not_computed(rows):
    found = {row.what: row.why for row in rows if isinstance(row, Skipped)}
    assert (
        "falsely certain" in found["Bayesian overall ratio of SDs of stiffness, right against left"]
    )


def test_the_page_says_what_the_bayesian_contrasts_are(made, computed):
    document = build_document(made)
    page = page_of(document | {"contrast": computed})
    assert "Bayesian contrasts come from a model of their own" in page
    assert "Bayesian contrasts come" not in page_of(document)


def skipped(table, family="lognormal", **tables):
    one = study(table, family, **tables)
    (row,) = contrast_rows(one.sessions, ("k",), one.scene.with_inference(method="bayesian"))
    assert row.what == "Bayesian contrast of stiffness, right against left"
    return row.why


def test_what_the_model_cannot_carry_is_said():
    table = frame()
    assert "two references" in skipped(table[table["environment"] == "VE1"])
    still = table.assign(k_adj=table["k_ref"])
    assert "zero scatter has no proper posterior" in skipped(still)
    none = {"model": {"pooling": "none", "prior": "reference"}}
    assert "partial" in skipped(table, **none)
    zero = table.assign(k_adj=np.where(table.index == 0, 0.0, table["k_adj"]))
    assert "has no logarithm" in skipped(zero)


@pytest.mark.evidence(reduced=True)
def test_limits_of_spread_state_the_error_that_seeds_have(made):
    """Seeds differ by what each states, within a factor of three."""
    ends, stated = [], []
    for seed in range(1, 9 if LONG else 3):
        scene = made.scene.with_inference(tolerance=0.05, method="bayesian", seed=seed)
        found = results(contrast_rows(made.sessions, ("k",), scene))
        rows = [row for row in found if row["of"] == "spread"]
        ends.append([[np.log(row["lower"]), np.log(row["upper"])] for row in rows])
        stated.append([row["error"] for row in rows])
        assert all(row["error"] is None for row in found if row["of"] == "bias")
    half_width = np.diff(ends, axis=2)[..., 0].mean(axis=0) / 2.0
    differ = np.sqrt((np.std(ends, axis=0, ddof=1) ** 2).mean(axis=1)) / half_width
    typical = np.sqrt((differ**2).mean())
    assert typical / 3.0 < np.mean(stated) < 3.0 * typical
    page = page_of(build_document(made) | {"contrast": found})
    assert ">Monte Carlo error</th>" in page
