"""Conditions within subjects: contrasts against SciPy on subjects' means, and what is left out
of them."""

import dataclasses
import re

import numpy as np
import pytest
from scipy import stats

from percept import Scene, Study, UsageError, read_sessions
from percept.report.adjustments import contrast_sentences
from percept.sessions import Sessions
from percept.study.conditions import by_level
from tests import DATASETS
from tests.documents import build_document, page_of
from tests.study.within import crossed, frame, reasons, study


def means(table, response):
    """Subjects' means of a response, (subject, (level, environment))."""
    return table.assign(y=response).pivot_table(
        index="subject", columns=["hand", "environment"], values="y"
    )


def row_of(contrasts, environment, of="bias", kind="mean"):
    rows = contrasts[contrasts["of"] == of]
    rows = rows[rows["kind"] == kind] if of == "bias" else rows
    rows = rows[
        rows["environment"].isna() if environment is None else rows["environment"] == environment
    ]
    (row,) = rows.to_dict("records")
    return row


@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_contrasts_are_those_of_subjects_means(family):
    table = frame()
    ratio = table["k_adj"] / table["k_ref"]
    wide = means(table, np.log(ratio) if family == "lognormal" else ratio - 1.0)
    found = study(table, family).contrasts
    for environment in ("VE1", "VE2", "VE3", None):
        left, right = (
            wide[level].mean(axis=1) if environment is None else wide[level, environment]
            for level in ("left", "right")
        )
        test, n = stats.ttest_rel(right, left), len(left)
        interval = test.confidence_interval(0.95)
        row = row_of(found, environment)
        ends = np.array([interval.low, (right - left).mean(), interval.high])
        expected = np.exp(ends) if family == "lognormal" else ends
        np.testing.assert_allclose(
            [row["lower"], row["estimate"], row["upper"]], expected, rtol=1e-9
        )
        assert (row["n"], row["first"], row["second"]) == (n, "left", "right")
        assert row["p_value"] == pytest.approx(test.pvalue, rel=1e-9)
        user = row_of(found, environment, kind="user")
        half = stats.t.isf(0.025, n - 1) * (right - left).std(ddof=1) * np.sqrt(1.0 + 1.0 / n)
        centre = np.log(user["upper"]) if family == "lognormal" else user["upper"]
        assert centre == pytest.approx((right - left).mean() + half, rel=1e-9)
        spread = row_of(found, environment, of="spread")
        assert spread["estimate"] == pytest.approx(right.std(ddof=1) / left.std(ddof=1), rel=1e-9)
        assert spread["p_value"] == pytest.approx(
            stats.pearsonr(left + right, right - left).pvalue, rel=1e-9
        )
    assert row_of(found, None)["references"] == ("VE1", "VE2", "VE3")


def test_overall_contrasts_rest_on_subjects_with_every_cell():
    table = frame()
    gone = (table["subject"] == "S2") & (table["environment"] == "VE3") & (table["hand"] == "right")
    gone |= (table["subject"] == "S5") & (table["hand"] == "left")
    kept = table[~gone]
    made = study(kept)
    wide = means(kept, np.log(kept["k_adj"] / kept["k_ref"])).drop(["S2", "S5"])
    right, left = (wide[level].mean(axis=1) for level in ("right", "left"))
    row = row_of(made.contrasts, None)
    assert (row["references"], row["n"]) == (("VE1", "VE2", "VE3"), 6)
    assert row["p_value"] == pytest.approx(stats.ttest_rel(right, left).pvalue, rel=1e-9)
    assert row_of(made.contrasts, "VE2")["n"] == 7
    sentences = build_document(made, curves=False)["summary"]["sentences"]
    assert "It rests on 6 of 8 subjects." in sentences[0]


@pytest.mark.parametrize("reference", [0.0, -6.0])
def test_contrasts_without_a_ratio_are_in_the_quantity_s_unit(reference):
    """With and without a scale: it only makes responses of the model unit-free."""
    table = frame()
    table["k_adj"] = table["k_adj"] / table["k_ref"] + reference
    table["k_ref"] = reference
    wide = means(table, table["k_adj"])
    for model in ({}, {"scale": {"k": 10.0}}):
        made = study(table, "normal", model=model)
        row = row_of(made.contrasts, None)
        right, left = (wide[level].mean(axis=1) for level in ("right", "left"))
        assert row["estimate"] == pytest.approx((right - left).mean(), rel=1e-9)
        interval = stats.ttest_rel(right, left).confidence_interval(0.95)
        assert (row["lower"], row["upper"]) == pytest.approx((interval.low, interval.high))
        assert row["unit"] == "N/m"
        page = page_of(build_document(made))
        assert "bias (N/m)" in page
        assert re.search(r" \(95 %: [+−][\d.]+ to [+−][\d.]+ N/m\)", page)
        assert "references, <data" not in page


def test_what_has_no_contrast_is_named():
    table = frame()
    table.loc[0, "k_adj"] = 0.0
    assert "has no logarithm (1 in all)" in reasons(study(table))["contrasts of stiffness"]
    scaled = study(frame().assign(k_ref=0.0), "normal", model={"scale": {"k": 10.0}}).contrasts
    unscaled = study(frame().query("environment == 'VE1'"), "normal").contrasts
    # In N/m, and in references of 10 N/m.
    assert row_of(scaled, "VE1")["lower"] == pytest.approx(
        10.0 * row_of(unscaled, "VE1")["lower"], rel=1e-12
    )
    alone = frame()
    alone = alone[(alone["subject"] == "S0") | (alone["hand"] == "left")]
    why = reasons(study(alone))
    assert why["contrast of stiffness, right against left, in VE1"].startswith(
        "fewer than two subjects"
    )
    apart = frame().query("(environment == 'VE1') == (hand == 'left')")
    with pytest.raises(
        UsageError, match="'hand': says nothing that the environments and the other"
    ):
        study(apart)


def test_levels_and_groups_that_never_meet_are_named():
    table = frame(levels=("a", "b", "c"))
    met = np.where(table["environment"] == "VE1", table["hand"] != "c", table["hand"] != "a")
    why = reasons(study(table[met]))
    there = "there are no data at all its levels"
    assert why["contrast of stiffness, c against a, in VE1, VE2, VE3"] == there
    assert why["contrast of stiffness, b against a, in VE2, VE3"] == there
    table["group"] = np.where(table["subject"] < "S4", "novice", "expert")
    apart = (table["group"] == "novice") & (table["environment"] == "VE1")
    why = reasons(study(table[~apart], model={"bias": "group"}))
    assert why["contrast of stiffness, expert against novice, in VE1"] == there
    table["load"] = np.where(table["trial"] == 1, "x", "y")
    corner = (table["hand"] == "c") & (table["load"] == "y")
    why = reasons(study(table[~corner], model={"bias": "hand * load"}))
    assert why["contrast of stiffness, c, y against a, x, in VE1, VE2, VE3"] == there


def test_slopes_that_the_classical_method_lacks_are_named():
    why = reasons(study(crossed(), bias="hand * load + dose"))
    said = "only the hierarchical model estimates slopes"
    assert why["classical slope of stiffness on dose"] == said


@pytest.fixture(scope="module")
def overall():
    """Results of one study by each family, and its contrast over all references."""

    def of_family(family):
        results = study(frame(), family).results(curves=False)
        (row,) = [
            row
            for row in results.contrast
            if (row.of, row.kind, row.environment) == ("bias", "mean", None)
        ]
        return results, row

    return {family: of_family(family) for family in ("lognormal", "normal")}


@pytest.mark.parametrize(
    ("together", "said"),
    [
        ((None, None), "is 1.5 times as large for hand right as for left (95 %: 1.2 to 1.9)."),
        ((1.1, 2.0), "is 1.5 times as large for hand right as for left (95 %: 1.2 to"),
        (
            (0.9, 2.2),
            "does not differ clearly between hand right and left: 1.5 times (95 %, together: 0.9"
            " to 2.2).",
        ),
    ],
)
def test_a_contrast_whose_joint_limits_hold_none_is_not_clear(overall, together, said):
    results, row = overall["lognormal"]
    numbers = dict(zip(("lower_together", "upper_together"), together, strict=True))
    row = dataclasses.replace(row, estimate=1.5, lower=1.2, upper=1.9, **numbers)
    (sentence,) = contrast_sentences(dataclasses.replace(results, contrast=(row,)))
    assert sentence.startswith(f"The stiffness {said}")


@pytest.mark.parametrize(
    ("references", "said"),
    [
        ((1000.0,), "100 N/m larger for hand right than for left (95 %: +50 to +150 N/m)."),
        ((10.0, 1000.0), "10 % of the reference larger for hand right than for left (95 %: +5"),
    ],
)
def test_differences_are_in_the_unit_of_the_data(overall, references, said):
    results, row = overall["normal"]
    row = dataclasses.replace(row, estimate=0.1, lower=0.05, upper=0.15)
    intervals = [
        dataclasses.replace(one, reference=references[index % len(references)])
        for index, one in enumerate(results.intervals)
    ]
    made = dataclasses.replace(results, contrast=(row,), intervals=tuple(intervals))
    (sentence,) = contrast_sentences(made)
    assert f"The stiffness is {said}" in sentence
    assert "references" not in sentence


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hand": "left"}, "all rows have one value"),
        ({"hand": ["left", ""] * 48}, "48 rows without a value"),
        # Brackets in names make "A (b) (c)" of two cells.
        (
            {
                "hand": ["b) (c", "b) (c", "c", "c"] * 24,
                "environment": (["A"] * 4 + ["A (b)"] * 4 + ["C"] * 4) * 8,
            },
            "two cells would have the name",
        ),
    ],
)
def test_columns_that_are_no_factor_are_refused(change, message):
    with pytest.raises(UsageError, match=message):
        study(frame().assign(trial=range(96), **change))


def test_factors_that_are_not_there_are_refused():
    sessions = Sessions.from_frame(frame(trials=1).query("hand == 'left'"))
    with pytest.raises(UsageError, match="column 'foot'"):
        Study(sessions, Scene(study={"factor": "foot"}))
    table = read_sessions(DATASETS / "hbfd_table1.csv")
    with pytest.raises(UsageError, match="published limits have no subjects"):
        by_level(table, ["hand"])
