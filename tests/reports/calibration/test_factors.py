"""Truths drawn from the prior of studies with factors lie evenly in their posteriors; wrong models
are caught.

The page does the same with 300 fits of each kind of study.
"""

import numpy as np
import pytest
from scipy import stats

from reports.calibration.fits import WRONG, fit_study, place_study
from reports.calibration.studies import KINDS
from reports.calibration.uniformity import Plan, calibrate

CROSSED = "two factors with interaction"


@pytest.mark.evidence
@pytest.mark.parametrize("kind", tuple(KINDS)[8:])
def test_truths_lie_evenly_in_their_posteriors(kind):
    judged = calibrate(Plan(kind=kind), place_study, 20)
    assert judged.reasons == ()
    assert judged.outside == []


@pytest.mark.evidence
@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_models_are_caught(wrong):
    kind, _ = WRONG[wrong]
    assert calibrate(Plan(kind=kind, wrong=wrong), place_study, 20).outside


@pytest.mark.evidence
def test_ratios_of_spread_lie_evenly_in_their_posteriors():
    """Ratio of the SDs between users at the two levels of a factor, averaged over their cells."""
    places = []
    for index in range(100):
        fitted = fit_study(Plan(kind=CROSSED), index)
        hand = fitted.drawn.observed.contrast["hand"]
        sides = np.stack([np.maximum(hand, 0.0), np.maximum(-hand, 0.0)])
        points = np.concatenate(fitted.run.independent())
        second, first = fitted.model.log_user_sds(sides, points).T
        places.append((second - first < true_log_ratio(fitted.drawn, sides)).mean())
    assert stats.kstest(places, "uniform").pvalue > 1e-3


def true_log_ratio(drawn, sides):
    """Log ratio of one user's SDs of two averages of cells, by the scales the study came from."""
    contrasts = drawn.observed.contrast
    stretch = np.exp(drawn.truth["eta:hand"] * contrasts["hand"])
    variance = sides**2 @ drawn.truth["sigma"][0] ** 2
    columns = {"sigma_u": np.ones_like(stretch)}
    columns |= {f"sigma_v:{term}": contrast for term, contrast in contrasts.items()}
    for name, column in columns.items():
        variance = variance + (drawn.truth[name] * (sides @ (stretch * column))) ** 2
    second, first = 0.5 * np.log(variance)
    return second - first
