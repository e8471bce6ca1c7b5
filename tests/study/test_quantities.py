"""Quantities that are no impedance: units, intervals, band laws, words, and parts that cannot be
had."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study
from percept.errors import RefusalError, UsageError
from percept.study.prepare import prepare
from tests.documents import build_document, page_of
from tests.study.within import reasons

DURATION = {"quantities": {"duration": {"symbol": "t", "unit": "ms"}}}
CLASSICAL = {"inference": {"method": "classical", "level": 0.95}}


def frame(references=(400.0, 600.0, 900.0, 1400.0), subjects=6):
    rng = np.random.default_rng(4)
    rows = [(f"P{i}", f"S{j}", r, r * np.exp(rng.normal(0.05, 0.1)))
            for i in range(subjects) for j, r in enumerate(references)]  # fmt: skip
    return pd.DataFrame(rows, columns=["subject", "environment", "duration_ref", "duration_adj"])


def study_of(table, tables):
    return Study(table, Scene(**tables))


def test_classical_numbers_are_scipys_in_the_unit_declared():
    table = frame()
    seconds = table.assign(duration_adj=table["duration_adj"] / 1000)
    columns = {"duration_adj": {"name": "duration_adj", "unit": "s"}}
    study = study_of(seconds, DURATION | CLASSICAL | {"columns": columns})
    rows = study.intervals.query("kind == 'mean' and family == 'normal'")
    assert set(rows["parameter"]) == {"duration"}
    assert set(rows["unit"]) == {"ms"}
    for name, values in table.groupby("environment")["duration_adj"]:
        wanted = stats.t.interval(0.95, len(values) - 1, values.mean(), values.sem())
        found = rows[rows["environment"] == name][["lower", "upper"]].to_numpy()[0]
        np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_the_band_law_is_against_the_reference_itself():
    study = study_of(frame(), DURATION | CLASSICAL)
    rows = pd.DataFrame(study.band.rows)
    np.testing.assert_allclose(rows["relative"], rows["band"] / rows["reference"], rtol=1e-15)
    assert {law.parameter for law in study.band.laws} == {"duration"}


def test_references_alike_cost_the_law_only():
    study = study_of(frame(references=(500.0, 500.0, 500.0)), DURATION | CLASSICAL)
    why = "without one environment all references lie within 5 % of each other"
    assert reasons(study)["band law"] == why
    assert study.band.laws == ()
    assert len(study.intervals) == 18


def test_zero_costs_what_needs_its_logarithm_only():
    table = frame()
    table.loc[0, "duration_adj"] = 0.0
    study = study_of(table, DURATION | {"inference": {"method": "both", "tolerance": 0.1}})
    left = reasons(study)
    why = "zero or negative values have no logarithm (1 there)"
    assert why in left["S0, in the hierarchical model"]
    assert left["classical lognormal intervals of duration in S0"] == "a value is zero or negative"
    families = study.intervals.groupby("environment")["family"].agg(set)
    both = {"normal", "lognormal"}
    assert families.to_dict() == {"S0": {"normal"}, "S1": both, "S2": both, "S3": both}
    cautions = build_document(study)["summary"]["cautions"]
    assert any(
        text.startswith("The hierarchical model leaves out S0: zero or negative")
        for text in cautions
    )
    every = table.assign(duration_adj=table["duration_adj"].where(table["subject"] != "P0", 0.0))
    left = reasons(study_of(every, DURATION))
    assert "no logarithm (4 in all)" in left["Bayesian intervals"]
    with pytest.raises(RefusalError, match="no logarithm"):
        _ = study_of(table, DURATION | {"inference": {"method": "bayesian"}}).intervals


def test_the_page_says_the_studys_words_and_none_of_haptics():
    words = {"study": {"environment": "standard", "subject": ["dyad", "dyads"], "verb": "timed"}}
    study = study_of(frame(), DURATION | CLASSICAL | words)
    page = page_of(build_document(study)).split("<script")[0].split("<main")[1]
    text = re.sub("<[^>]*>", "", page.split('id="data"')[0])
    text = text.replace("point of subjective equality", "")
    assert "6 dyads timed duration in 4 standards, once each" in text
    for word in ("tiffness", "damping", "impedance", "oupling", "N/m", "nvironment ", "ubject"):
        assert word not in text, word


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        (
            {"quantities": {"k": {"unit": "s"}}},
            "k is stiffness in N/m: name another quantity apart",
        ),
        ({"quantities": {"two words": {}}}, "letters, digits and single underscores"),
        (DURATION | {"columns": {"k_adj": "x"}}, "columns.k_adj: there is no quantity 'k'"),
        ({"inference": {"together": ["k"]}}, "two quantities have a model together"),
    ],
)
def test_what_is_wrong_with_quantities_is_named(tables, said):
    with pytest.raises(UsageError, match=said):
        Scene(**tables)


def three_quantities():
    rng = np.random.default_rng(9)
    rows = [(f"P{i}", f"S{j}", *(value for scale in (1.0, 2.0, 5.0) for r in [scale * 10.0**j]
                                 for value in (r, r * np.exp(rng.normal(0, 0.2)))))
            for i in range(5) for j in range(3)]  # fmt: skip
    names = [f"{name}_{kind}" for name in ("force", "length", "weight") for kind in ("ref", "adj")]
    return pd.DataFrame(rows, columns=["subject", "environment", *names])


def prepared(tables):
    quantities = {"quantities": {"force": {}, "length": {}, "weight": {}}}
    return prepare(study_of(three_quantities(), quantities | tables).data)


def test_of_three_quantities_the_two_named_together_share_a_model():
    found = prepared({"inference": {"together": ["weight", "force"]}})
    why = "two are modelled together at most; [inference] together names them"
    assert found.skipped[0].why == why
    assert any("rho" in name for name in found.model.names)
    assert not any("rho" in name for name in prepared({}).model.names)
