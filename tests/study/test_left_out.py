from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy import stats

from percept import RefusalError, Scene, Study, read_sessions
from percept.report.left_out import left_out_document, left_out_markdown
from percept.sessions import Sessions
from percept.study.prediction import LeftOut, expected_users, leave_one_environment_out, predict
from tests import DATASETS
from tests.unmixed import UNMIXED, unmixed_sessions

KEPT = ("VE2", "VE3", "VE4")


def published(*environments: str, **inference: object) -> Study:
    sessions = read_sessions(DATASETS / "hbfd_table1.csv")
    table = sessions.table[sessions.table["environment"].isin(environments)]
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(**{"tolerance": 0.3, "level": 0.9, **inference})
    return Study(dataclasses.replace(sessions, table=table), scene)


@pytest.fixture(scope="module")
def study() -> Study:
    return published(*KEPT)


@pytest.fixture(scope="module")
def others() -> Study:
    """What is left where VE3 is left out."""
    return published("VE2", "VE4")


@pytest.fixture(scope="module")
def found(study: Study) -> LeftOut:
    return leave_one_environment_out(study)


def test_each_row_is_the_prediction_of_a_study_without_it(found: LeftOut, others: Study) -> None:
    assert [(row.environment, row.parameter) for row in found.rows.itertuples()] == [
        (e, p) for e in KEPT for p in ("k", "b")
    ]
    predicted = predict(others, stiffness=1e4, damping=10.0)
    for row in found.rows[found.rows["environment"] == "VE3"].to_dict("records"):
        own = predicted.intervals["parameter"] == row["parameter"]
        limits = predicted.intervals[own].set_index("kind")
        assert (row["lower"], row["upper"]) == tuple(limits.loc["mean", ["lower", "upper"]])
        assert (row["user_lower"], row["user_upper"]) == tuple(limits.loc["user", ["lower", "upper"]])
        assert row["beyond"] == 0.0
    assert found.rows.set_index(["environment", "parameter"]).loc[("VE4", "k"), "beyond"] == pytest.approx(
        np.log10(2.5)
    )


def test_observed_mean_and_users_by_hand(found: LeftOut) -> None:
    row = found.rows.set_index(["environment", "parameter"]).loc[("VE3", "b")]
    # Back from the limits 8.1880 and 13.1459 at 99 %, n = 10, then from mean and SD to their logarithms.
    limits = read_sessions(DATASETS / "hbfd_table1.csv").table.set_index(["environment", "parameter"])
    lower, upper = limits.loc[("VE3", "b"), ["lower", "upper"]].astype(float)
    mean = 0.5 * (lower + upper)
    sd = 0.5 * (upper - lower) / stats.t.isf(0.005, 9) * np.sqrt(10)
    log_sd = np.sqrt(np.log1p((sd / mean) ** 2))
    geometric = mean / np.exp(0.5 * log_sd**2)
    assert row["observed"] == pytest.approx(geometric)
    assert row["inside"] == (row["lower"] <= geometric <= row["upper"])
    users = stats.norm(np.log(geometric), log_sd)
    share = users.cdf(np.log(row["user_upper"])) - users.cdf(np.log(row["user_lower"]))
    assert row["users_inside"] == pytest.approx(share)


def test_place_is_that_of_a_mean_of_as_many_users(found: LeftOut, others: Study) -> None:
    """Simulated means of ten predicted users, instead of the mixture's distribution function."""
    assert others.fit is not None
    x = np.log10(1e4 / np.sqrt(1e3 * 25e3)), np.log10(10.0 / np.sqrt(1.0 * 25.0))
    laws = expected_users(others.fit, np.array(x), others.scene.inference).laws
    rng = np.random.default_rng(1)
    rows = found.rows.set_index(["environment", "parameter"])
    for p, (parameter, reference) in enumerate((("k", 1e4), ("b", 10.0))):
        average = laws.mean[:, p] + laws.sd[:, p] * rng.standard_normal(len(laws.mean))
        noise = rng.standard_normal((len(average), 10)).mean(axis=1)
        means = reference * np.exp(average + laws.population_sd[:, p] * noise)
        row = rows.loc[("VE3", parameter)]
        share = np.mean(means < row["observed"])
        error = np.sqrt(share * (1.0 - share) / len(means))
        assert abs(row["place"] - share) < 4.0 * error


def test_place_under_the_normal_family_is_relative_to_the_reference() -> None:
    asked = {"family": "normal", "method": "bayesian", "parameters": ("k",)}
    found = leave_one_environment_out(published(*KEPT, **asked))
    row = found.rows.set_index("environment").loc["VE3"]
    others = published("VE2", "VE4", **asked)
    assert others.fit is not None
    x = np.array([np.log10(1e4 / np.sqrt(1e3 * 25e3))])
    laws = expected_users(others.fit, x, others.scene.inference).laws
    rng = np.random.default_rng(1)
    average = laws.mean[:, 0] + laws.sd[:, 0] * rng.standard_normal(len(laws.mean))
    noise = rng.standard_normal((len(average), 10)).mean(axis=1)
    means = 1e4 * (1.0 + average + laws.population_sd[:, 0] * noise)
    share = np.mean(means < row["observed"])
    assert 0.0 < share < 1.0
    assert abs(row["place"] - share) < 4.0 * np.sqrt(share * (1.0 - share) / len(means))


def test_document_and_page_say_the_same(study: Study, found: LeftOut) -> None:
    document = json.loads(json.dumps(left_out_document(study, found)))
    assert document["sentence"] == found.sentence
    assert [row["place"] for row in document["rows"]] == found.rows["place"].tolist()
    page = left_out_markdown(document)
    assert "hbfd_table1.csv" in page
    lines = [line for line in page.splitlines() if line.startswith("| VE")]
    assert len(lines) == 6
    for line, row in zip(lines, document["rows"], strict=True):
        assert f"| {row['place']:.3f} |" in line
        assert ("| yes |" in line) == row["inside"]
    assert "0.4 decades above" in next(line for line in lines if line.startswith("| VE4 | k"))


@pytest.mark.parametrize(("family", "mean"), [("lognormal", "geometric mean"), ("normal", "mean")])
def test_the_observed_mean_is_named_by_its_family(study: Study, found: LeftOut, family, mean) -> None:
    document = {**left_out_document(study, found), "family": family}
    assert f"| observed {mean} |" in left_out_markdown(document)


def test_a_name_stays_in_its_cell(study: Study, found: LeftOut) -> None:
    document = left_out_document(study, found)
    document["rows"][0]["environment"] = "V|1\n\\x"
    (line,) = (line for line in left_out_markdown(document).splitlines() if line.startswith("| V\\|1"))
    assert line.startswith("| V\\|1 \\\\x | k |")


def test_what_lies_outside_is_named(found: LeftOut) -> None:
    rows = found.rows.assign(inside=[True, True, False, True, True, False])
    said = dataclasses.replace(found, rows=rows).sentence
    assert said.startswith("4 of 6 observed means lie inside the 90 % interval")
    assert said.endswith("Outside: k of VE3, b of VE4.")


def test_an_environment_whose_fit_is_withheld_is_skipped_with_the_reason() -> None:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(level=0.9, **UNMIXED)
    found = leave_one_environment_out(Study(Sessions.from_frame(unmixed_sessions(*KEPT)), scene))
    skipped = [name for name, _ in found.skipped]
    assert {"VE2", "VE3"} <= set(skipped)
    assert all("withheld" in why for _, why in found.skipped)
    assert sorted([*skipped, *found.rows["environment"].unique()]) == list(KEPT)


def test_refused() -> None:
    with pytest.raises(RefusalError, match="leaving one of 2 environments out"):
        leave_one_environment_out(published("VE2", "VE3"))
    with pytest.raises(RefusalError, match="classical method has no model"):
        leave_one_environment_out(published(*KEPT, method="classical"))
