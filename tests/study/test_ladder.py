"""Classical against Bayesian intervals: in pairs, and the steps from one to the other."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions
from percept.results import Ladder, LadderEffect
from percept.study.ladder import sentence
from tests import DATASETS
from tests.study.checked import study_of, table_of

REFERENCE = {"pooling": "none", "prior": "reference"}


def ladder_of(study: Study) -> Ladder:
    ladder = study.ladder
    assert ladder is not None
    return ladder


def effects_of(ladder: Ladder) -> pd.DataFrame:
    return pd.DataFrame(ladder.effects)


@pytest.fixture(scope="module")
def outlying() -> Study:
    """Three environments of one bias and one whose users adjust 30 % lower; a fifth met by one
    subject."""
    table = table_of(
        subjects=10,
        references=[[100.0, 1e3, 1e4, 3e4, 5e4]],
        alpha=0.3,
        tau=0.02,
        sigma_u=0.0,
        s=0.2,
    )
    table.loc[table["environment"] == "VE2", "k_adj"] *= 0.7
    table = table[(table["environment"] != "VE5") | (table["subject"] == "S01")]
    return study_of(table, method="both", family="normal")


def test_the_same_method_twice_makes_no_difference_beyond_its_error() -> None:
    """Under the reference prior without pooling the posterior is Eq. 15's t, whose limits have
    no error."""
    study = study_of(
        table_of(("k", "b"), subjects=6), model=REFERENCE, method="both", family="normal"
    )
    ladder = ladder_of(study)
    effects = pd.DataFrame(ladder.effects)
    assert list(effects["cause"].unique()) == ["all", "sampling"]
    assert len(effects) == 2 * 6 * 3
    apart = effects["log_width"] / effects["log_width_error"]
    assert apart.abs().max() < 4.0
    # Of six independent environments and parameters.
    assert 0.3 < np.sqrt((apart**2).mean()) < 2.0
    assert effects["log_width_error"].max() < 0.05
    # Each draw's law is centred on the mean: the interval's centre has no error but rounding.
    assert effects["centre"].abs().max() < 1e-12
    for text in ladder.sentences:
        assert (
            ": both intervals of the average user have the same width and centre, to within" in text
        )


def test_a_tight_prior_is_named_and_no_other_environment_where_there_is_one() -> None:
    table = table_of(subjects=8, references=[[1e3]], alpha=0.5)
    study = study_of(table, model={"priors": {"alpha_sd": 0.05}}, method="both", family="normal")
    ladder = ladder_of(study)
    assert list(effects_of(ladder)["cause"].unique()) == ["all", "prior"]
    assert (effects_of(ladder).query("kind == 'mean'")["centre"] < -1.0).all()
    (text,) = ladder.sentences
    assert "as the classical one, because the priors say how users usually adjust (×" in text
    assert "half-width lower, because the priors" in text
    assert "other environments" not in text
    assert "log scale" not in text


def test_an_outlying_environment_is_explained_by_pooling(outlying: Study) -> None:
    ladder = ladder_of(outlying)
    assert list(effects_of(ladder)["cause"].unique()) == ["all", "prior", "pooling"]
    (text,) = (text for text in ladder.sentences if text.startswith("VE2, stiffness: "))
    assert "because the model also learns from the other environments (×" in text
    assert text.index("the model also learns") < text.find("the priors") % len(text)
    assert "Its centre lies" in text
    assert "half-width higher, because the model also learns from the other environments (+" in text


def test_an_environment_that_cannot_stand_alone_has_a_note_and_no_ladder(outlying: Study) -> None:
    (note,) = ladder_of(outlying).notes
    assert note.startswith(
        "VE5: the step of the prior is missing: at least two subjects are needed"
    )
    assert set(effects_of(ladder_of(outlying))["environment"]) == {"VE1", "VE2", "VE3", "VE4"}


def test_steps_lead_from_the_classical_interval_to_the_bayesian(outlying: Study) -> None:
    effects, intervals = effects_of(ladder_of(outlying)), outlying.intervals
    rows = intervals.query("joint == 'marginal' and family == 'normal'").set_index(
        ["method", "environment", "parameter", "kind"]
    )
    for cell, steps in effects.groupby(["environment", "parameter", "kind"]):
        whole, rest = steps.iloc[0], steps.iloc[1:]
        (low, high), (below, above) = (
            rows.loc[(method, *cell), ["lower", "upper"]].to_numpy(dtype=float)
            for method in ("classical", "bayesian")
        )
        assert whole["log_width"] == pytest.approx(np.log((above - below) / (high - low)))
        assert whole["centre"] == pytest.approx((below + above - low - high) / (high - low))
        for name in ("log_width", "centre"):
            assert rest[name].sum() == pytest.approx(whole[name], abs=1e-12)


def test_skewed_data_are_explained_by_the_log_scale() -> None:
    ladder = ladder_of(study_of(table_of(subjects=40, references=[[1e3]], s=0.8), method="both"))
    assert list(effects_of(ladder)["cause"].unique()) == ["all", "prior", "scale"]
    (text,) = ladder.sentences
    assert "because the log scale makes the typical user the geometric mean (×" in text
    assert (
        "half-width lower, because the log scale makes the typical user the geometric mean (-"
        in text
    )


def study_of_noise(scatter: float, noise: float) -> Study:
    """Twenty users of one environment, four trials each, with SDs between users and trials."""
    users = np.repeat(np.arange(20), 4)
    rng = np.random.default_rng(3)
    deviation = scatter * rng.standard_normal(20)[users] + noise * rng.standard_normal(80)
    table = pd.DataFrame(
        {
            "subject": [f"S{user:02d}" for user in users],
            "environment": "VE1",
            "trial": np.tile(np.arange(1, 5), 20),
            "k_ref": 1e3,
            "k_adj": 1e3 * (1.0 + deviation),
        }
    )
    return study_of(table, method="both", family="normal")


def test_trial_noise_is_named_where_users_scatter_by_nothing_else() -> None:
    ladder = ladder_of(study_of_noise(scatter=0.0, noise=0.2))
    assert list(effects_of(ladder)["cause"].unique()) == ["all", "prior", "trials"]
    widths = effects_of(ladder).query("kind == 'user'").set_index("cause")["log_width"]
    assert widths["trials"] < np.log(0.7)
    assert abs(widths["prior"]) < 0.1
    _, of_user = ladder.sentences
    assert "as the classical one, because the model leaves trial noise out (×" in of_user


def test_trial_sds_of_each_user_are_a_step_of_their_own() -> None:
    scene = Scene(inference={"family": "normal", "tolerance": 0.3})
    sessions = read_sessions("tests/golden/data/own_trials.csv", scene=scene)
    causes = effects_of(ladder_of(Study(sessions, scene)))["cause"].unique()
    assert list(causes) == ["all", "prior", "trials", "pooling", "own_trials"]


def study_of_pair(correlation: float) -> Study:
    """Stiffness set without bias, damping far off what its prior holds possible."""
    rng = np.random.default_rng(4)
    scores = rng.standard_normal((12, 2))
    scores -= scores.mean(axis=0)
    vectors, _, _ = np.linalg.svd(scores, full_matrices=False)
    k = vectors[:, 0]
    b = correlation * vectors[:, 0] + np.sqrt(1.0 - correlation**2) * vectors[:, 1]
    table = pd.DataFrame(
        {
            "subject": [f"S{user:02d}" for user in range(12)],
            "environment": "VE1",
            "k_ref": 1e3,
            "b_ref": 5.0,
            "k_adj": 1e3 * (1.0 + 0.6 * k),
            "b_adj": 5.0 * (1.4 + 0.6 * b),
        }
    )
    tight = {"priors": {"alpha_sd": 0.05, "tau_scale": 0.05}}
    return study_of(table, model=tight, method="both", family="normal")


@pytest.mark.parametrize(("correlation", "named"), [(0.95, True), (0.0, False)])
def test_correlation_is_named_where_nothing_else_moves_an_interval(
    correlation: float, named: bool
) -> None:
    """Only what damping's prior does, through the correlation, can move stiffness."""
    ladder = ladder_of(study_of_pair(correlation))
    assert list(effects_of(ladder)["cause"].unique()) == ["all", "prior", "correlation"]
    centres = (
        effects_of(ladder).query("kind == 'mean' and parameter == 'k'").set_index("cause")["centre"]
    )
    assert abs(centres["prior"]) < 0.05
    assert (centres["correlation"] < -0.2) == named
    (of_stiffness, _) = ladder.sentences
    because = ", because the model also learns from the other quantity (-"
    assert (f"half-width lower{because}" in of_stiffness) == named


def steps_of(kind: str = "user", **steps: tuple[float, float]) -> list[LadderEffect]:
    """Effects on log width and centre, with errors of .01 each."""
    rows = {"all": tuple(np.sum(list(steps.values()), axis=0).tolist()), **steps}
    return [
        LadderEffect(
            environment="VE1", parameter="b", kind=kind, cause=cause, log_width=width,
            log_width_error=0.01, centre=centre, centre_error=0.01,
        )
        for cause, (width, centre) in rows.items()
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("effects", "text"),
    [
        (
            steps_of("share", prior=(-0.3, 0.0), pooling=(0.2, 0.0), scale=(0.1, 0.0)),
            "VE1, damping: the Bayesian interval of most users is as wide as the classical one: "
            "the priors "
            "say how users usually adjust (×0.74); the model also learns from the other "
            "environments "
            "(×1.22); users scatter by ratios on the log scale (×1.11).",
        ),
        (
            steps_of(
                "mean", prior=(0.01, 0.0), pooling=(np.log(1.1), 0.0), scale=(np.log(1.3), 0.0)
            ),
            "VE1, damping: the Bayesian interval of the average user is 1.44 times as wide as "
            "the classical "
            "one, because the log scale makes the typical user the geometric mean (×1.30); the "
            "model also "
            "learns from the other environments (×1.10).",
        ),
        (
            steps_of("share", prior=(np.log(0.8), 0.3), pooling=(np.log(1.251), 0.0)),
            "VE1, damping: the Bayesian interval of most users is as wide as the classical one: "
            "the model "
            "also learns from the other environments (×1.25); the priors say how users usually "
            "adjust "
            "(×0.80). Its centre lies 30 % of the classical half-width higher, because the "
            "priors say how "
            "users usually adjust (+30 %).",
        ),
        (
            steps_of("mean", sampling=(np.log(1.03), 0.0)),
            "VE1, damping: the Bayesian interval of the average user is 1.03 times as wide as "
            "the classical "
            "one, because draws are random (×1.03).",
        ),
        (
            steps_of("mean", prior=(0.005, 0.01), pooling=(0.005, 0.01)),
            "VE1, damping: both intervals of the average user have the same width and centre, to "
            "within 2 %.",
        ),
    ],
)
def test_a_difference_in_words(effects: list[LadderEffect], text: str) -> None:
    study = study_of(table_of(("k", "b"), subjects=2), method="classical")
    assert sentence(effects, study.data) == text


def test_pairs_by_hand(fitted: Study) -> None:
    pairs = fitted.comparison
    assert pairs is not None
    assert len(pairs) == 30
    where = {"environment": "VE3", "parameter": "b", "kind": "user", "family": "lognormal"}
    (pair,) = [one for one in pairs if where.items() <= vars(one).items()]
    rows = [one for one in fitted.interval_rows if where.items() <= vars(one).items()]
    old, new = [one for one in rows if one.joint == "marginal"]
    assert pair.width_ratio == pytest.approx((new.upper - new.lower) / (old.upper - old.lower))
    assert pair.shift == pytest.approx(new.estimate / old.estimate - 1.0)


def test_tables_are_the_caller_s_own(fitted: Study) -> None:
    """What is changed in a table asked for changes nothing of the study."""
    before = fitted.intervals
    changed = fitted.intervals
    changed.iloc[:, 0] = "changed"
    pd.testing.assert_frame_equal(fitted.intervals, before)


def test_levels_of_a_factor_have_a_ladder_each() -> None:
    """An environment by itself has one level: its step leaves the factor out."""
    scene = Scene.load(DATASETS / "sleep.toml").with_inference(tolerance=0.2, kinds=["mean"])
    study = Study(read_sessions(DATASETS / "sleep.csv", scene=scene), scene)
    ladder = study.ladder
    assert ladder is not None
    assert ladder.notes == ()
    causes = effects_of(ladder).groupby("environment")["cause"].agg(list).to_dict()
    steps = ["all", "prior", "pooling"]
    assert causes == {"nights (first)": steps, "nights (second)": steps}
