"""Which method to use: the studies simulated for it, and the recommendation drawn from them."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study
from percept.calibration.advice import (
    ADVICE_FILE,
    STUDIES,
    _sentences,
    advice_plans,
    gather,
    recommend,
)
from percept.cli import main
from percept.sessions import Sessions
from percept.sessions.quantities import IMPEDANCE
from tests.study.checked import study_of, table_of

PLAIN = table_of(("k", "b"), subjects=5, references=[[100.0, 1e3], [1.0, 5.0]], sigma_u=0.0)
SCENE = {"method": "both", "tolerance": 0.3, "model": {"subject_effect": False}}


@pytest.fixture(scope="module")
def plain() -> Study:
    return study_of(PLAIN, **SCENE)


@pytest.fixture(scope="module")
def study() -> Study:
    """Two environments with repeats, one cell without a trial."""
    once = table_of(("k", "b"), subjects=6, references=[[100.0, 1e3], [1.0, 5.0]])
    again = once.assign(trial=2, k_adj=once["k_adj"] * 1.02, b_adj=once["b_adj"] * 0.97)
    table = pd.concat([once, again.iloc[:7]]).drop(columns="source")
    table = table[(table["subject"] != "S06") | (table["environment"] != "VE2")]
    rng = np.random.default_rng(1)
    table[["k_adj", "b_adj"]] *= np.exp(0.02 * rng.normal(size=(len(table), 2)))
    return study_of(table, method="both", tolerance=0.2, model={"priors": {"tau_scale": 0.4}})


def test_normal_users_have_the_mean_and_sd_of_their_cell(study: Study) -> None:
    own = advice_plans(study)[1].values
    assert own is not None
    assert not own.cov_u.any()
    assert own.sigma_e.min() > 0.0
    for j, environment in enumerate(study.data.environments):
        rows = study.sessions.table[study.sessions.table["environment"] == environment]
        trials = rows.groupby("subject").size()
        for i, parameter in enumerate(("k", "b")):
            values = (
                rows.groupby("subject")[f"{parameter}_adj"].mean()
                / study.data.reference[parameter, environment]
            )
            assert own.beta[j, i] == pytest.approx(values.mean() - 1.0)
            noise = own.sigma_e[j, i] ** 2 * (1.0 / trials).mean()
            assert own.sigma[j, i] ** 2 + noise == pytest.approx(values.var(ddof=1))


def test_a_recommendation_rests_on_enough_studies(plain: Study, tmp_path) -> None:
    table = gather(
        advice_plans(plain)[:1], tmp_path / "judged.jsonl", studies={"bayesian": 2, "classical": 3}
    )
    assert len(table) == 2 * 4
    assert table.groupby("method")["studies"].min().to_dict() == {"bayesian": 2, "classical": 3}
    table.to_csv(tmp_path / ADVICE_FILE, index=False)
    # Normal users without pooling are missing, and a recommendation needs both truths.
    (text,) = recommend(plain, tmp_path, "percept calibrate", {"bayesian": 2, "classical": 3})
    assert text.endswith("For this design percept calibrate would tell.")
    twice = pd.concat([table, table.assign(plan=advice_plans(plain)[1].key)])
    twice.to_csv(tmp_path / ADVICE_FILE, index=False)
    told = recommend(plain, tmp_path, "percept calibrate", {"bayesian": 2, "classical": 3})
    assert [text.split(" use ")[0] for text in told] == [
        "For stiffness in VE1", "For stiffness in VE2", "For damping in VE1", "For damping in VE2",
    ]  # fmt: skip
    for bayesian, classical in ((3, 3), (2, 4)):
        enough = {"bayesian": bayesian, "classical": classical}
        (text,) = recommend(plain, tmp_path, "percept calibrate", enough)
        assert "percept calibrate would tell" in text


def covered(**held: tuple[float, float]) -> pd.DataFrame:
    """Coverage of each method under both truths, with an error of .001."""
    return pd.DataFrame(
        {"claim": "b in VE1", "method": m, "family": {"bayesian": "lognormal"}.get(m, "normal"),
         "stated": 0.99, "held": value, "error": 0.001, "users": users}
        for m, values in held.items()
        for value, users in zip(values, ("users of the fitted model", "normal users"), strict=True)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (
            covered(bayesian=(0.9905, 0.99), classical=(0.979, 0.99)),
            "For damping in VE1 use the Bayesian interval of the next user: it covers 99.00 ± "
            "0.10 % of "
            "normal users where 99 % is stated. The classical one covers 97.90 ± 0.10 % of users "
            "of the "
            "fitted model and is 1.40 times as wide.",
        ),
        (
            covered(bayesian=(0.98, 0.99), classical=(0.989, 0.99)),
            "For damping in VE1 use the classical interval of the next user: it covers 98.90 ± "
            "0.10 % of "
            "users of the fitted model where 99 % is stated. The Bayesian one covers 98.00 ± "
            "0.10 % of users "
            "of the fitted model and is 0.71 times as wide.",
        ),
        # Both keep what they state: the narrower.
        (
            covered(bayesian=(0.99, 0.991), classical=(0.99, 0.9905)),
            "For damping in VE1 use the Bayesian interval of the next user: it covers 99.00 ± "
            "0.10 % of "
            "users of the fitted model where 99 % is stated. The classical one covers 99.00 ± "
            "0.10 % of "
            "users of the fitted model and is 1.40 times as wide.",
        ),
        # Neither does: the one that covers more.
        (
            covered(bayesian=(0.96, 0.99), classical=(0.99, 0.97)),
            "Neither method keeps its level for damping in VE1. "
            "For damping in VE1 use the classical interval of the next user: it covers 97.00 ± "
            "0.10 % of "
            "normal users where 99 % is stated. The Bayesian one covers 96.00 ± 0.10 % of users "
            "of the "
            "fitted model and is 0.71 times as wide.",
        ),
    ],
)  # fmt: skip
def test_the_truth_a_method_covers_least_decides(table: pd.DataFrame, text: str) -> None:
    rows = [
        ("bayesian", "lognormal", 0.0, 1.0),
        ("classical", "normal", -0.4, 1.0),
        ("classical", "lognormal", 0.0, 9.0),
    ]
    intervals = pd.DataFrame(rows, columns=["method", "family", "lower", "upper"]).assign(
        environment="VE1", parameter="b", kind="user", joint="marginal"
    )
    assert " ".join(_sentences(table, intervals, IMPEDANCE)) == text
    assert not list(_sentences(table[table["method"] == "classical"], intervals, IMPEDANCE))


def test_a_study_that_cannot_be_simulated_has_theory_alone() -> None:
    scene = Scene(inference={"method": "classical"})
    one = Study(Sessions.from_frame(table_of(subjects=4)), scene)
    (text,) = recommend(one, "nowhere", "percept calibrate")
    assert text.startswith(
        "Which to use: for normal users the classical intervals cover exactly what they state."
    )
    assert (
        "Studies like this one cannot be simulated: calibration needs a passed Bayesian fit" in text
    )
    assert "would tell" not in text


@pytest.mark.evidence
def test_calibrate_writes_what_compare_recommends_by(
    plain: Study, tmp_path, monkeypatch, capsys
) -> None:
    """The studies stand in the folder already, and are found although the study is fitted again."""
    monkeypatch.setenv("PERCEPT_CACHE", str(tmp_path / "cache"))
    PLAIN.to_csv(tmp_path / "sessions.csv", index=False)
    words = [str(tmp_path / "sessions.csv"), "--scene", str(tmp_path / "scene.toml"), "--quiet"]
    (tmp_path / "scene.toml").write_text(
        "[inference]\ntolerance = 0.3\nseed = 7\n[model]\nsubject_effect = false\n"
    )
    out = tmp_path / "coverage"
    assert main(["compare", *words, "--coverage", str(out)]) == 0
    command = f"{words[0]} --scene {words[2]} --out {out} --advice would tell."
    assert f"For this design percept calibrate {command}" in capsys.readouterr().out
    out.mkdir()
    lines = []
    for plan in advice_plans(plain):
        for method, count in STUDIES.items():
            key = plan.by("both" if method == "bayesian" else method).key
            family = "lognormal" if method == "bayesian" else "normal"
            judged = [
                [f"{p} in {e}", "user", method, family, "marginal", "", 0.99]
                for p in ("k", "b") for e in plain.data.environments
            ]  # fmt: skip
            lines += [json.dumps({"plan": key, "index": i, "judged": judged}) for i in range(count)]
    (out / "judged.jsonl").write_text("\n".join(lines) + "\n")
    assert main(["calibrate", *words, "--advice", "--workers", "1", "--out", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out / ADVICE_FILE)
    assert main(["compare", *words, "--coverage", str(out)]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if " use the " in line]
    assert len(told) == 4
    assert all("where 99 % is stated" in line for line in told)
