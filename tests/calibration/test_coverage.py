from __future__ import annotations

import dataclasses
import json
import math
import types
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import RefusalError, Scene, Study, UsageError, read_sessions
from percept.calibration import (
    averaged,
    coverage,
    coverage_markdown,
    fitted_values,
    plan_like,
)
from percept.checkpoint import plan_digest
from percept.judge import (
    CoveragePlan,
    Held,
    Labels,
    Population,
    interval_held,
    judge_study,
)
from percept.sessions import Sessions
from percept.simulate import Design, Hyperparameters, TrueValues
from percept.workers import on_cluster
from tests import DATASETS, LONG
from tests.fits import SHARED
from tests.golden.studies import SEED, TOLERANCE
from tests.workers.clusters import QUIET, in_threads

REFERENCES = ((10.0, 0.1), (1000.0, 1.0), (25_000.0, 25.0))


def planned(
    references=REFERENCES, subjects=5, points=4, *, truth="lognormal", values=None, **asked
):
    """Plan studies of stiffness and damping, by the classical method unless asked otherwise."""
    scene = Scene(
        device={"mass": 1.0, "damping": 5.0, "period": 0.001},
        frequency={"lower": 0.1, "upper": 100.0, "points": points},
        model={"subjects_trial_sd": False},
        inference={"method": "classical", "level": 0.9, "share": 0.9, "tolerance": 0.05, "seed": 1}
        | asked,
    )
    design = Design.balanced(references, subjects=subjects)
    return CoveragePlan(design=design, scene=scene, users_family=truth, values=values)


PLAN = planned()
NORMAL = Population("normal", np.array([100.0, 2.0]), np.array([0.1, 0.0]), np.diag([0.01, 0.04]))


def fixed_values(*, spread: float, environments: int, parameters: int = 2) -> TrueValues:
    """Unbiased users of one spread everywhere, k and b independent."""
    zero = np.zeros((environments, parameters))
    return TrueValues(
        hyper=Hyperparameters(),
        beta=zero,
        sigma=zero + spread,
        sigma_e=zero,
    )


def found(rows: pd.DataFrame, **wanted: str) -> Any:
    """Return the one row with these labels."""
    (row,) = rows[(rows[list(wanted)] == list(wanted.values())).all(axis=1)].itertuples()
    return row


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    values = fixed_values(spread=1.5, environments=2)
    studies = 200 if LONG else 16
    plan = planned(REFERENCES[:2], values=values)
    scene = plan.scene.model_copy(update={"device": None})
    return coverage(dataclasses.replace(plan, scene=scene), studies)


@pytest.mark.evidence(reduced=True)
def test_classical_coverage_is_the_stated_one_in_the_right_family(rows: pd.DataFrame) -> None:
    for kind in ("mean", "user", "share"):
        row = found(rows, claim="interval", kind=kind, family="lognormal", joint="marginal")
        assert row.stated == (0.95 if kind == "share" else 0.9)
        assert abs(row.held - row.stated) < 4 * row.error


@pytest.mark.evidence(reduced=True)
def test_the_wrong_family_is_caught(rows: pd.DataFrame) -> None:
    """Users with an SD of 1.5 of the logarithm are so skewed that the t-interval of their mean
    misses it."""
    row = found(rows, claim="interval", kind="mean", family="normal", joint="marginal")
    assert row.held < 0.9 - 4 * row.error


@QUIET
def test_runs_go_on_where_they_stopped_and_do_not_depend_on_workers(tmp_path: Path) -> None:
    path = tmp_path / "judged.jsonl"
    plan = plan_like(durations(), method="classical")
    before = coverage(plan, 2, checkpoint=path)
    with path.open("a") as file:
        file.write('{"plan": "' + plan_digest(plan) + '", "index": 2, "jud')  # cut short
    done: list[tuple[int, int]] = []
    pytest.importorskip("distributed", reason="needs the extra percept-haptics[cluster]")

    def told(count: int, of: int) -> None:
        done.append((count, of))

    with in_threads() as client:
        rows = coverage(plan, 4, mapper=on_cluster(client), checkpoint=path, progress=told)
    assert done == [(3, 4), (4, 4)]
    pd.testing.assert_frame_equal(rows, coverage(plan, 4))
    # Another plan does not take these lines for its own.
    assert not coverage(
        plan_like(durations(seed=2), method="classical"), 2, checkpoint=path
    ).equals(before)
    pd.testing.assert_frame_equal(coverage(plan, 2, checkpoint=path), before)


def test_a_checkpoint_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "judged.jsonl"
    path.write_text("nonsense\n" + json.dumps({"plan": "x", "index": 0, "judged": []}) + "\n")
    with pytest.raises(UsageError, match="not a line of judged studies"):
        coverage(PLAN, 2, checkpoint=path)


def test_truth_of_a_population() -> None:
    users = Population(
        "lognormal", np.array([100.0, 2.0]), np.array([0.1, 0.0]), np.diag([0.04, 0.25])
    )
    log = stats.norm(np.log(100.0) + 0.1, 0.2)
    drawn = users.users(20_000, np.random.default_rng(1))
    assert stats.kstest(np.log(drawn[:, 0]), log.cdf).pvalue > 1e-4
    inside = log.cdf(np.log(140.0)) - log.cdf(np.log(90.0))
    assert users.content(0, 90.0, 140.0) == pytest.approx(inside, rel=1e-12)
    assert users.below(0, -1.0) == 0.0
    averages = [100.0 * np.exp(0.1 + 0.02), 2.0 * np.exp(0.125)]
    np.testing.assert_allclose(users.average("normal"), averages, rtol=1e-12)
    np.testing.assert_allclose(users.average("lognormal"), [100.0 * np.exp(0.1), 2.0])
    exact = [
        stats.norm(m, s).expect(np.log, lb=m - 8 * s if m > 8 * s else 1e-9)
        for m, s in ((110, 10), (2, 0.4))
    ]
    np.testing.assert_allclose(np.log(NORMAL.average("lognormal")), exact, rtol=1e-4)


@pytest.mark.parametrize(("upper", "held"), [(120.0, 0.0), (124.0, 1.0)])
def test_limits_of_a_share_hold_where_they_contain_the_share(upper: float, held: float) -> None:
    """Of normals at 110 with SD 10, 84 % and 92 % lie below; the confidence is of another
    question."""
    row = types.SimpleNamespace(
        parameter="k", kind="share", lower=0.0, upper=upper, level=0.9, share=0.9, confidence=0.95,
        family="normal",
    )  # fmt: skip
    assert interval_held(row, NORMAL) == held


def test_withheld_studies_count_among_all_and_claims_among_those_that_make_them() -> None:
    def interval(truth: float) -> Held:
        return {Labels("interval", "mean", "bayesian", "lognormal", "marginal"): truth}

    withheld = {Labels("withheld", method="bayesian", family="lognormal"): 1.0}
    rows = averaged(PLAN, [withheld, interval(1.0), interval(0.0), interval(1.0)])
    none, some = found(rows, claim="withheld"), found(rows, claim="interval")
    assert (none.held, none.studies) == (0.25, 4)
    assert math.isnan(none.stated)
    assert (some.held, some.studies, some.stated) == (pytest.approx(2 / 3), 3, 0.9)
    assert some.error == pytest.approx(np.std([1, 0, 1], ddof=1) / np.sqrt(3))


def test_fitted_values_are_those_of_the_fit() -> None:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(
        tolerance=TOLERANCE, seed=SEED, method="bayesian"
    )
    study = Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene, store=SHARED)
    truth = fitted_values(study)
    assert study.fit is not None
    model = study.fit.model
    named = {name: values for name, (_, values) in model.scales(study.fit.points).items()}
    for name in ("rho_u", "rho_w"):
        assert getattr(truth.hyper, name) == pytest.approx(named[name].mean())
    np.testing.assert_allclose(truth.beta.mean(axis=0), truth.hyper.alpha, rtol=1e-12)
    np.testing.assert_allclose(truth.sigma.T, named["sigma"].mean(axis=0), rtol=1e-12)
    reference = np.array([study.data.reference[cell] for cell in model.cells])
    # Estimates are of all kept draws, and good to .05 of half-widths of some tenths.
    centre = np.log(study.fit.estimate / reference).reshape(2, -1)
    np.testing.assert_allclose(truth.beta.T, centre, atol=0.02)


def test_bayesian_claims_are_judged() -> None:
    judged = judge_study(planned(method="both", tolerance=0.2, seed=4), 0)
    claims = {(labels.claim, labels.method) for labels in judged}
    assert {("interval", "bayesian"), ("boundary throughout", "bayesian")} <= claims
    assert all(0.0 <= held <= 1.0 for held in judged.values())


def test_normal_users_below_zero_are_refused_by_a_lognormal_model_and_said_so() -> None:
    values = fixed_values(spread=2.0, environments=3)
    plan = planned(method="both", truth="normal", values=values)
    assert [one.claim for one in judge_study(plan, 0) if one.method == "bayesian"] == ["refused"]
    table = coverage_markdown(coverage(plan, 2))
    assert "| refused |" in table


@pytest.mark.parametrize("spread", [300.0, 1e4], ids=["beyond any file", "beyond doubles"])
def test_studies_that_no_file_may_hold_are_refused_and_counted(spread: float) -> None:
    values = fixed_values(spread=spread, environments=3)
    rows = coverage(planned(method="both", values=values), 2)
    assert rows["claim"].tolist() == ["refused", "refused"]
    assert rows["method"].tolist() == ["classical", "bayesian"]
    assert rows["held"].tolist() == [1.0, 1.0]


def durations(**changes: object) -> Study:
    """Six subjects reproduce three durations twice."""
    rng = np.random.default_rng(5)
    rows = pd.DataFrame(
        [(s, f"D{r}", r, t) for s in "abcdef" for r in (400.0, 900.0, 2000.0) for t in (1, 2)],
        columns=["subject", "environment", "duration_ref", "trial"],
    )
    rows["duration_adj"] = rows["duration_ref"] * np.exp(rng.normal(-0.1, 0.2, len(rows)))
    scene = Scene(quantities={"duration": {"unit": "ms"}}, inference=changes)
    return Study(Sessions.from_frame(rows, scene=Scene(quantities=scene.quantities)), scene)


def test_a_single_quantity_is_simulated_as_two_are() -> None:
    plan = plan_like(durations(level=0.9), method="classical")
    assert plan.design.parameters == ("duration",)
    assert plan.design.references.tolist() == [[400.0], [900.0], [2000.0]]
    assert plan.design.trials.tolist() == 6 * [[2, 2, 2]]
    assert set(coverage(plan, 2)["claim"]) == {"interval"}


def test_wrong_plans() -> None:
    with pytest.raises(UsageError, match="at least two environments"):
        planned(((1.0, 1.0),))
    with pytest.raises(UsageError, match="at least two subjects"):
        planned(subjects=1)
    with pytest.raises(UsageError, match="at least two studies"):
        coverage(PLAN, 1)


def test_fitted_values_need_a_fit() -> None:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    with pytest.raises(RefusalError, match="needs a passed Bayesian fit"):
        fitted_values(Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene))
