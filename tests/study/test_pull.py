"""Priors that move the answers: said with the line that changes it, and undone by that line."""

import re

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study
from percept.report.cautions import cautions
from percept.sessions import Sessions
from percept.study.results import diagnostics_of
from tests.documents import build_document


def study_of(spread, *, subjects=6, environments=1, model=None, **tables):
    """Subjects about twice the reference, with the given SD of the logarithm."""
    rng = np.random.default_rng(0)
    rows = [
        (
            f"S{s}",
            f"VE{e}",
            10.0 ** (e + 1),
            2.0 * 10.0 ** (e + 1) * np.exp(rng.normal(0.0, spread)),
        )
        for s in range(subjects)
        for e in range(environments)
    ]
    table = pd.DataFrame(rows, columns=["subject", "environment", "k_ref", "k_adj"])
    scene = Scene(inference={"tolerance": 0.05}, model=model or {}, **tables)
    return Study(Sessions.from_frame(table), scene)


def widening(study):
    """Width of the Bayesian next user over the classical one, on the log scale, largest cell."""
    rows = study.intervals.query("kind == 'user' and family == 'lognormal' and joint == 'marginal'")
    rows = rows.assign(width=np.log(rows["upper"] / rows["lower"]))
    by_method = rows.pivot_table(index="environment", columns="method", values="width")
    return float((by_method["bayesian"] / by_method["classical"]).max())


@pytest.mark.parametrize(
    ("spread", "least", "against"),
    [
        (0.01, 1.5, "without that prior"),
        (0.002, 3.0, "without that prior"),
        (1e-12, 1e9, "the classical one"),
    ],
)
def test_precise_data_overruled_by_the_prior_of_spread_are_said_with_what_to_set(
    spread, least, against
):
    study = study_of(spread)
    (said,) = diagnostics_of(study.parts).pull
    assert "expects more spread in stiffness than the data show" in said
    stated = float(re.search(r"interval (\S+) times as wide as " + against, said)[1])
    # Without its prior one environment has the classical prediction interval.
    assert widening(study) > least
    assert stated == pytest.approx(widening(study), rel=0.1)
    assert said in build_document(study, curves=False)["summary"]["cautions"]
    key, value = re.search(r"Set (\w+) = (\d+) in \[model.priors\]", said).groups()
    changed = study_of(spread, model={"priors": {key: float(value)}})
    assert diagnostics_of(changed.parts).pull == ()
    assert widening(changed) < 1.25


@pytest.mark.parametrize(
    ("spread", "subjects", "environments"),
    [(0.2, 6, 1), (0.2, 2, 1), (0.2, 10, 3), (0.3, 3, 2), (0.1, 4, 3)],
)
def test_ordinary_studies_are_not_pulled(spread, subjects, environments):
    found = diagnostics_of(study_of(spread, subjects=subjects, environments=environments).parts)
    assert found.gate.passed
    assert found.pull == ()


def test_coarse_data_are_pulled_the_other_way():
    of_bias, said = diagnostics_of(study_of(4.0, subjects=5).parts).pull
    assert of_bias.startswith("The prior of the common bias")
    assert "expects less spread in stiffness than the data show" in said
    assert re.search(r"interval 0\.\d+ times as wide", said)


def test_the_study_s_word_for_users_is_used():
    (said,) = diagnostics_of(study_of(0.01, study={"subject": "driver"}).parts).pull
    assert "spread between drivers" in said
    assert "next driver’s interval" in said


def test_a_reference_prior_has_no_pull():
    study = study_of(1e-6, model={"pooling": "none", "prior": "reference"})
    assert diagnostics_of(study.parts).pull == ()


def scaled_study(scale):
    """Settings of about 24 mm against references of zero, with both hands, without checks."""
    rng = np.random.default_rng(0)
    rows = []
    for subject in range(8):
        own = rng.normal(0.0, 2.0)
        for hand, mean in (("left", 24.0), ("right", 20.0)):
            rows.append((f"S{subject}", "VE0", hand, 0.0, mean + own + rng.normal()))
    columns = ["subject", "environment", "hand", "d_ref", "d_adj"]
    scene = Scene(
        quantities={"d": {"unit": "mm"}},
        study={"factor": "hand"},
        model={"scale": {"d": scale}, "bias": "hand"},
        inference={"family": "normal", "tolerance": 0.05},
    )
    sessions = Sessions.from_frame(pd.DataFrame(rows, columns=columns), scene=scene)
    return Study(sessions, scene)


@pytest.mark.evidence
def test_a_scale_far_smaller_than_the_settings_is_named_without_checks():
    study = scaled_study(1.0)
    rows = study.intervals.query("kind == 'mean' and method == 'bayesian'")
    assert (rows["estimate"] < 10.0).all()
    said = [text for text in cautions(study.results()) if "prior of the common bias" in text]
    assert len(said) == 1
    assert "Its unit is [model] scale.d = 1 (mm). Set a scale about as large" in said[0]
    large_enough = scaled_study(25.0)
    rows = large_enough.intervals.query("kind == 'mean' and method == 'bayesian'")
    assert (rows["estimate"] > 18.0).all()
    assert not any("common bias" in text for text in diagnostics_of(large_enough.parts).pull)
