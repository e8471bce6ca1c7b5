"""Trials with references of their own, of which no two are equal."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study
from percept.errors import RefusalError, UsageError
from percept.sessions import Sessions
from percept.study.conditions import at_typical_references
from tests.documents import build_document
from tests.study.within import only

SLOPE = 0.25


def frame(*, subjects=4, trials=40, slope_sd=0.0, seed=3, environments=("",)):
    """Each subject's own references over a decade and a half, drawn evenly."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(subjects):
        level = rng.normal(0.1, 0.1)
        slope = SLOPE + rng.normal(0.0, slope_sd)
        for number, environment in enumerate(environments):
            decades = rng.uniform(-0.75, 0.75, trials)
            noise = rng.normal(0.0, 0.08, trials) + 0.2 * number
            references = 100.0 * 10.0**decades
            adjusted = references * np.exp(level + slope * decades + noise)
            for trial, (reference, value) in enumerate(zip(references, adjusted, strict=True)):
                rows.append([f"S{subject}", environment, trial + 1, reference, value])
    columns = ["subject", "environment", "trial", "k_ref", "k_adj"]
    made = pd.DataFrame(rows, columns=columns)
    return made.drop(columns="environment") if environments == ("",) else made


def scene_of(*, bias="reference", parameters=None, **model):
    inference = {"method": "bayesian", "tolerance": 0.3, "parameters": parameters}
    return Scene(model={"bias": bias, **model}, inference=inference)


def read(made):
    return Sessions.from_frame(made, scene=scene_of())


def test_adjustments_keep_their_ratio_to_the_trial_s_reference():
    made = frame(environments=("soft", "hard"))
    sessions = read(made)
    np.testing.assert_array_equal(sessions.table["k_ref"], made["k_ref"])
    told = at_typical_references(sessions, scene_of()).table
    np.testing.assert_allclose(told["k_adj"] / told["k_ref"], made["k_adj"] / made["k_ref"])
    np.testing.assert_allclose(told["k_ref"] * 10.0 ** told["reference"], made["k_ref"])
    for environment, rows in told.groupby("environment"):
        own = made["k_ref"][made["environment"] == environment]
        (typical,) = set(rows["k_ref"])
        assert typical == pytest.approx(stats.gmean(own))


def test_references_without_environments_fall_into_ranges_of_equal_size():
    made = frame()
    study = Study(read(made), scene_of())
    told = study.sessions.table
    assert list(told.groupby("environment").size()) == [32] * 5
    for environment, rows in told.groupby("environment"):
        low, high = map(float, environment.split(" to "))
        own = made["k_ref"][rows.index]
        assert (low, high) == pytest.approx((own.min(), own.max()), rel=1e-5)
    assert study.sessions.environments[0].startswith(f"{made['k_ref'].min():.6g}")
    # A study of these sessions is the same study.
    assert Study(study.sessions, scene_of()).sessions.table.equals(told)
    (notice,) = [note.text for note in study.sessions.notices if "geometric mean" in note.text]
    assert notice == "k_adj is restated at the geometric mean of each environment's k_ref"


@pytest.fixture(scope="module")
def fitted_trials():
    return Study(frame(), scene_of())


def test_a_planted_slope_is_found_over_ranges_and_within(fitted_trials):
    """Estimates against least squares with a level for every subject."""
    table = fitted_trials.psychophysics
    gamma = only(table, measure="gamma")
    assert gamma["lower"] < SLOPE < gamma["upper"]
    told = fitted_trials.sessions.table
    response = np.log(told["k_adj"] / told["k_ref"])
    cells = [told["subject"], told["environment"]]
    own = told["reference"] - told["reference"].groupby(cells).transform("mean")
    left = response - response.groupby(cells).transform("mean")
    within = float(own @ left / (own @ own))
    row = fitted_trials.contrasts.iloc[0]
    assert (row["second"], row["first"]) == ("1 decade more", "the same")
    assert row["lower"] < np.exp(SLOPE) < row["upper"]
    error = 0.08 / np.sqrt(own @ own)
    # Differences between subjects' levels within a range tell of the slope too.
    assert np.log(row["estimate"]) == pytest.approx(within, abs=2.0 * error)


def test_a_slope_is_said_of_settings_and_of_their_ratio(fitted_trials):
    document = build_document(fitted_trials)
    said = re.match(
        r"Per decade of reference the stiffness is ([\d.]+) times as large: the ratio to the"
        r" reference rises to ([\d.]+) times \(99 %: ([\d.]+) to ([\d.]+)\)\.",
        document["summary"]["sentences"][0],
    )
    row = fitted_trials.contrasts.iloc[0]
    numbers = [10 * row["estimate"], row["estimate"], row["lower"], row["upper"]]
    assert [float(number) for number in said.groups()] == pytest.approx(numbers, rel=0.01)


def test_the_reader_names_the_remedy():
    made = frame(environments=("soft", "hard"))
    with pytest.raises(UsageError, match=r'by trial, set \[model\] bias = "reference"'):
        Sessions.from_frame(made)
    study = Study(frame(), Scene(inference={"method": "bayesian"}))
    with pytest.raises(RefusalError, match=r"two subjects .* set \[model\] bias = .reference"):
        _ = study.intervals


def test_a_trial_without_reference_is_refused():
    made = frame(environments=("soft", "hard"))
    made.loc[7, "k_ref"] = np.nan
    with pytest.raises(UsageError, match="1 environment without a reference: 'soft'"):
        read(made)


@pytest.mark.parametrize(
    ("changed", "scene", "message"),
    [
        ({"k_ref": 5.0}, scene_of(), "every environment has one reference"),
        ({"k_ref": [-1.0, 2.0] * 80}, scene_of(), "must be positive"),
        ({}, Scene(), "the sessions were read with .* which the scene lacks"),
    ],
)
def test_references_that_the_model_cannot_carry_are_refused(changed, scene, message):
    sessions = read(frame().assign(environment="one", **changed))
    with pytest.raises(UsageError, match=message):
        Study(sessions, scene)


def test_one_quantity_has_references_by_trial():
    made = frame()
    made = made.assign(b_ref=made["k_ref"], b_adj=made["k_adj"] * 1.01)
    with pytest.raises(UsageError, match="k_ref and b_ref vary by trial"):
        Study(made, scene_of())
    study = Study(made, scene_of(parameters=["k"]))
    assert study.data.parameters == ("k",)
