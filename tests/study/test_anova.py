"""Analysis of variance of studies: against contrasts and pivoted means, and what it refuses."""

import re

import numpy as np
import pytest
from scipy import stats

from percept.inference.classical.contrasts import anova
from percept.results import AnovaRow
from tests.documents import build_document, page_of
from tests.study.within import crossed, frame, only, reasons, study


def effects_of(made):
    return {row.factor: row for row in made.anova if isinstance(row, AnovaRow)}


@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_two_levels_have_the_p_of_the_overall_contrast(family):
    made = study(frame(), family)
    overall = only(made.contrasts, of="bias", kind="mean", environment=None)
    test = effects_of(made)["hand"]
    assert test.p_corrected == pytest.approx(overall["p_value"], rel=1e-9)
    assert (test.n, test.df, test.df_error) == (8, 1.0, 7.0)
    assert test.family == family


def test_crossed_factors_and_groups_are_those_of_pivoted_means():
    table = crossed()
    made = study(table, bias="load * hand + group + dose")
    found = effects_of(made)
    y = np.log(table["k_adj"] / table["k_ref"])
    keys = ["environment", "hand", "load"]
    wide = table.assign(y=y).pivot_table(index="subject", columns=keys, values="y", sort=False)
    group = table.groupby("subject", sort=False)["group"].first().map({"novice": 0, "expert": 1})
    effects = anova(
        wide.to_numpy().reshape(8, 3, 2, 2), keys, group=group.to_numpy(), between="group"
    )
    expected = {":".join(effect.factors): effect for effect in effects}
    # The model has no interaction with the group.
    kept = {name for name in expected if "group" not in name.split(":")}
    order = {"hand:load": "load:hand", "environment:hand:load": "environment:load:hand"}
    renamed = {order.get(name, name): expected[name] for name in kept}
    assert set(found) == {*renamed, "group", "group:environment"}
    for name, effect in renamed.items():
        assert found[name].f == pytest.approx(effect.f, rel=1e-9)
        assert found[name].epsilon == pytest.approx(effect.epsilon, rel=1e-9)
    assert found["group"].p_value == pytest.approx(expected["group"].p_value, rel=1e-9)


def test_one_reference_and_groups_alone_are_a_t_test_of_subjects_means():
    table = crossed().query("environment == 'VE1' and hand == 'left' and load == 'low'")
    found = effects_of(study(table, bias="group"))
    y = np.log(table["k_adj"] / table["k_ref"]).groupby(table["subject"]).mean()
    group = table.groupby("subject")["group"].first()
    test = stats.ttest_ind(y[group == "novice"], y[group == "expert"])
    assert list(found) == ["group"]
    assert found["group"].f == pytest.approx(test.statistic**2, rel=1e-9)
    assert found["group"].p_value == pytest.approx(test.pvalue, rel=1e-9)


ANOVA = "analysis of variance of stiffness"


def test_incomplete_subjects_are_named_with_what_to_do():
    table = frame()
    gone = table.eval("subject == 'S2' and environment == 'VE3' and hand == 'right'")
    made = study(table[~gone])
    assert effects_of(made) == {}
    why = reasons(made)[ANOVA]
    assert why.startswith("S2 has no trial in VE3 (right), and the analysis needs complete cells.")
    rule = '{ column = "subject", equals = "S2", why = "incomplete" }'
    assert f"To leave S2 out: [sessions] exclude = [{rule}]." in why
    gone |= table.eval("subject == 'S5' and hand == 'left'")
    assert "Cells are missing for 2 subjects in all." in reasons(study(table[~gone]))[ANOVA]
    # The rule it names works.
    complete = study(table[~gone & ~table["subject"].isin(["S2", "S5"])])
    assert effects_of(complete)["hand"].n == 6


def test_two_columns_of_groups_are_refused():
    table = crossed().query("hand == 'left' and load == 'low'")
    number = table["subject"].str[1:].astype(int)
    table = table.assign(site=np.where(number % 4 < 2, "north", "south"))
    assert (
        reasons(study(table, bias="group + site"))[ANOVA]
        == "it compares the groups of one column only"
    )


def test_levels_hold_every_subject_on_the_scale_of_the_contrasts():
    table = crossed()
    made = study(table, bias="hand * load + group")
    overall = [row for row in made.levels if row.environment is None]
    levels = {(row.factor, row.level): row.values for row in overall}
    y = np.log(table["k_adj"] / table["k_ref"])
    keys = [table[name] for name in ("subject", "hand", "environment", "load")]
    expected = y.groupby(keys, sort=False).mean().groupby(level=[0, 1], sort=False).mean().unstack()
    for hand in ("left", "right"):
        np.testing.assert_allclose(levels["hand", hand], np.exp(expected[hand]), rtol=1e-12)
    for group, present in (("novice", [True, False]), ("expert", [False, True])):
        assert [value is not None for value in levels["group", group]] == present * 4


def test_the_methods_paragraph_is_written_from_the_design():
    made = study(crossed(), bias="hand * load + group + dose")
    page = page_of(build_document(made, curves=False))
    text = re.sub("<[^>]*>", "", page[page.index('id="paragraph"') :]).split("BibTeX")[0]
    text = " ".join(text.split())
    assert "3 virtual environments at each of 2 levels of hand and 2 levels of load, in 2" in text
    assert "by group: novice 4, expert 4." in text
    assert "are empty" not in text
    assert "own log ratios, and their spreads by Pitman’s and Morgan’s test; groups by" in text
    assert "with Greenhouse’s and Geisser’s correction [greenhouse1959]." in text
    assert "On methods in the analysis of profile data" in text


def test_cells_of_other_groups_are_not_missing():
    made = study(crossed(), bias="hand * load + group")
    assert not [notice for notice in made.sessions.warnings if "no trial" in notice.text]
    table = crossed()
    gone = table.eval("subject == 'S2' and environment == 'VE3' and hand == 'left'")
    made = study(table[~gone], bias="hand * load + group")
    (notice,) = [notice for notice in made.sessions.warnings if "no trial" in notice.text]
    assert notice.text == (
        "2 cells have no trial: 'S2 at VE3 (left, low, novice)', 'S2 at VE3 (left, high, novice)'"
    )
    document = build_document(made, curves=False)
    assert document["data"]["design"]["cells"] == 96
    assert document["data"]["design"]["missing"] == 2
