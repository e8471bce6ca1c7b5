"""Published studies with factors and groups: the printed direction, and the printed t and F."""

import math

import pytest

from percept import Scene, Study, read_sessions
from tests import DATASETS
from tests.study.within import only


def analysed(name):
    scene = Scene.load(DATASETS / f"{name}.toml").with_inference(method="classical")
    return Study(read_sessions(DATASETS / f"{name}.csv", scene=scene), scene)


def effect(made, factor):
    (row,) = [row for row in made.anova if row.factor == factor]
    return row


def means(made, factor):
    rows = made.contrasts.query("factor == @factor")
    levels = rows[(rows["of"] == "level") & (rows["kind"] == "mean")]
    return dict(zip(levels["second"], levels["estimate"], strict=True))


def test_student_s_sleepers():
    """Student prints the means and their difference; Fisher t, and odds beyond 1 in 100."""
    made = analysed("sleep")
    found = means(made, "drug")
    assert {name: round(mean, 2) for name, mean in found.items()} == {"first": 0.75, "second": 2.33}
    row = only(made.contrasts, of="bias", kind="mean")
    assert round(row["estimate"], 2) == 1.58
    assert row["unit"] == "h"
    assert row["p_value"] < 0.01
    test = effect(made, "drug")
    assert (test.df, test.df_error) == (1, 9)
    assert round(math.sqrt(test.f), 2) == 4.06
    assert test.p_corrected == pytest.approx(row["p_value"], rel=1e-9)


def test_effort_of_rising_from_stools():
    """Devore prints the means; F is Pinheiro's and Bates's."""
    made = analysed("stools")
    test = effect(made, "stool")
    assert (round(test.f, 2), test.df, test.df_error) == (22.36, 3, 24)
    # In references of 6.
    found = {name: round(6.0 + 6.0 * mean, 2) for name, mean in means(made, "stool").items()}
    assert found == {"T1": 8.56, "T2": 12.44, "T3": 10.78, "T4": 9.22}


def test_growth_of_girls_and_boys():
    """F and epsilon are printed by M. Davidian; the groups are unequal."""
    made = analysed("growth")
    sex = effect(made, "sex")
    age = effect(made, "age")
    both = effect(made, "sex:age")
    assert [round(row.f, 2) for row in (sex, age, both)] == [9.29, 35.35, 2.36]
    assert [(row.df, row.df_error) for row in (sex, age, both)] == [(1, 25), (3, 75), (3, 75)]
    assert round(sex.p_value, 4) == 0.0054
    assert round(both.p_value, 4) == 0.0781
    assert round(age.epsilon, 4) == round(both.epsilon, 4) == 0.8672
    of_sex = means(made, "sex")
    assert of_sex["boy"] > of_sex["girl"]
    of_age = list(means(made, "age").values())
    assert of_age == sorted(of_age)
