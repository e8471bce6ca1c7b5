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
from percept.study.conditions import told_apart
from tests import DATASETS
from tests.documents import build_document, page_of
from tests.study.within import crossed, ends_of, frame, only, reasons, study


def sides(table, response, environment=None):
    """Each subject's mean at either level: in one environment, or over all."""
    cells = [table["subject"], table["hand"], table["environment"]]
    wide = response.groupby(cells).mean().unstack(["hand", "environment"])
    columns = slice(None) if environment is None else [environment]
    return [wide[level][columns].mean(axis=1, skipna=False) for level in ("left", "right")]


def overall(contrasts, **where):
    return only(contrasts, **{"environment": None, "of": "bias", "kind": "mean", **where})


@pytest.mark.parametrize("family", ["lognormal", "normal"])
@pytest.mark.parametrize("environment", ["VE1", "VE3", None])
def test_contrasts_are_those_of_subjects_means(family, environment):
    table = frame()
    ratio = table["k_adj"] / table["k_ref"]
    log = family == "lognormal"
    left, right = sides(table, np.log(ratio) if log else ratio - 1.0, environment)
    test = stats.ttest_rel(right, left)
    interval = test.confidence_interval(0.95)
    found = study(table, family).contrasts
    row = overall(found, environment=environment)
    limits = np.log(ends_of(row)) if log else ends_of(row)
    mean = (right - left).mean()
    assert limits == pytest.approx([interval.low, mean, interval.high], rel=1e-9)
    assert (row["n"], row["first"], row["second"]) == (8, "left", "right")
    assert row["p_value"] == pytest.approx(test.pvalue, rel=1e-9)
    assert row["references"] == ((environment,) if environment else ("VE1", "VE2", "VE3"))
    user = overall(found, environment=environment, kind="user")["upper"]
    half = stats.t.isf(0.025, 7) * (right - left).std(ddof=1) * np.sqrt(1.0 + 1.0 / 8)
    assert (np.log(user) if log else user) == pytest.approx(mean + half, rel=1e-9)
    spread = overall(found, environment=environment, of="spread", kind=None)
    assert spread["estimate"] == pytest.approx(right.std(ddof=1) / left.std(ddof=1), rel=1e-9)
    p_value = stats.pearsonr(left + right, right - left).pvalue
    assert spread["p_value"] == pytest.approx(p_value, rel=1e-9)


def test_overall_contrasts_rest_on_subjects_with_every_cell():
    gone = "(subject == 'S2' and environment == 'VE3' and hand == 'right')"
    table = frame().query(f"not ({gone} or (subject == 'S5' and hand == 'left'))")
    made = study(table)
    left, right = sides(table, np.log(table["k_adj"] / table["k_ref"]))
    row = overall(made.contrasts)
    assert (row["references"], row["n"]) == (("VE1", "VE2", "VE3"), 6)
    p_value = stats.ttest_rel(right, left, nan_policy="omit").pvalue
    assert row["p_value"] == pytest.approx(p_value, rel=1e-9)
    assert overall(made.contrasts, environment="VE2")["n"] == 7
    sentences = build_document(made, curves=False)["summary"]["sentences"]
    assert "It rests on 6 of 8 subjects." in sentences[0]


@pytest.mark.parametrize("reference", [0.0, -6.0])
@pytest.mark.parametrize("model", [{}, {"scale": {"k": 10.0}}])
def test_contrasts_without_a_ratio_are_in_the_quantity_s_unit(reference, model):
    """With and without a scale: it only makes responses of the model unit-free."""
    table = frame()
    table["k_adj"] = table["k_adj"] / table["k_ref"] + reference
    table["k_ref"] = reference
    left, right = sides(table, table["k_adj"])
    made = study(table, "normal", model=model)
    row = overall(made.contrasts)
    interval = stats.ttest_rel(right, left).confidence_interval(0.95)
    assert ends_of(row) == pytest.approx([interval.low, (right - left).mean(), interval.high])
    assert row["unit"] == "N/m"
    page = page_of(build_document(made))
    assert "bias (N/m)" in page
    assert re.search(r" \(95 %: [+−][\d.]+ to [+−][\d.]+ N/m\)", page)
    assert "references, <data" not in page


def test_what_has_no_contrast_is_named():
    table = frame()
    table.loc[0, "k_adj"] = 0.0
    assert "has no logarithm (1 in all)" in reasons(study(table))["contrasts of stiffness"]
    alone = frame().query("subject == 'S0' or hand == 'left'")
    why = reasons(study(alone))["contrast of stiffness, right against left, in VE1"]
    assert why.startswith("fewer than two subjects")
    apart = frame().query("(environment == 'VE1') == (hand == 'left')")
    message = "'hand': says nothing that the environments and the other"
    with pytest.raises(UsageError, match=message):
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
def contrasted(request):
    """Results of a study by one family, and its contrast over all references."""
    results = study(frame(), request.param).results(curves=False)
    wanted = ("bias", "mean", None)
    (row,) = [row for row in results.contrast if (row.of, row.kind, row.environment) == wanted]
    return results, row


@pytest.mark.parametrize("contrasted", ["lognormal"], indirect=True)
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
def test_a_contrast_whose_joint_limits_hold_none_is_not_clear(contrasted, together, said):
    results, row = contrasted
    numbers = dict(zip(("lower_together", "upper_together"), together, strict=True))
    row = dataclasses.replace(row, estimate=1.5, lower=1.2, upper=1.9, **numbers)
    (sentence,) = contrast_sentences(dataclasses.replace(results, contrast=(row,)))
    assert sentence.startswith(f"The stiffness {said}")


@pytest.mark.parametrize("contrasted", ["normal"], indirect=True)
@pytest.mark.parametrize(
    ("references", "said"),
    [
        ((1000.0,), "100 N/m larger for hand right than for left (95 %: +50 to +150 N/m)."),
        ((10.0, 1000.0), "10 % of the reference larger for hand right than for left (95 %: +5"),
    ],
)
def test_differences_are_in_the_unit_of_the_data(contrasted, references, said):
    results, row = contrasted
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
        told_apart(table, Scene(study={"factor": "hand"}))
