import numpy as np
import pytest

from percept.errors import UsageError
from percept.inference import Interval, Moments, prediction_interval, t_interval, tolerance_interval
from percept.inference.record import percent

X = np.random.default_rng(10).lognormal(2.0, 0.3, 10)


def bayesian(kind, **fields):
    given = {
        "family": "lognormal",
        "level": 0.99,
        "lower": 1.0,
        "upper": 2.0,
        "estimate": 1.5,
        "n": 10,
    }
    return Interval(kind=kind, method="bayesian", **(given | fields)).covers


def test_the_average_user_is_not_99_percent_of_users():
    assert (
        t_interval(X, unit="N/m").covers
        == "The average user's value lies between the limits, with 99 % confidence (from 10 users,"
        " in N/m); it is not a range of users, and holds an expected 64.7 % of them."
    )


def test_the_next_user():
    assert (
        prediction_interval(Moments(1.0, 1.0, 10, repeats=False)).covers
        == "The next user's value lies between the limits, with 99 % confidence (from 10 users, one"
        " trial each, trial noise included)."
    )


def test_single_trials_are_said_of_published_moments_under_lognormal_too():
    interval = t_interval(Moments(10.0, 2.0, 10, repeats=False), family="lognormal")
    assert interval.repeats is False
    assert "(from 10 users, one trial each" in interval.covers


def test_a_share_of_users_after_repeated_trials():
    moments = Moments(1.0, 1.0, 10, repeats=True)
    assert (
        tolerance_interval(moments, share=0.9).covers
        == "At least 90 % of all users lie between the limits, with 95 % confidence (from 10 users,"
        " each the mean of repeated trials, the rest of the trial noise included)."
    )


def test_families_name_whom_the_mean_stands_for():
    assert t_interval(X, family="lognormal").covers.startswith(
        "The typical user's value (the geometric mean"
    )


def test_joint_and_approximate_are_said():
    assert "both quantities are true together" in t_interval(X, joint="bonferroni").covers
    assert "moment matching" in t_interval(Moments(3.0, 1.0, 10), family="lognormal").covers


def test_bayesian_sentences_speak_of_probability_and_leave_trial_noise_out():
    assert (
        bayesian("user", repeats=True)
        == "The next user's value lies between the limits, with 99 % probability under the model"
        " and its priors (from 10 users, trial noise left out)."
    )
    assert (
        bayesian("share", repeats=False, share=0.99, confidence=0.95)
        == "At least 99 % of all users lie between the limits, with 95 % probability under the"
        " model and its priors (from 10 users, one trial each, trial noise included)."
    )
    assert "trial noise" not in bayesian("mean", repeats=True)


def test_many_sizes_are_a_range():
    covers = t_interval(Moments(0.0, 1.0, [10, 30])).covers
    assert "from 10 to 30 users" in covers
    assert "an expected 37.6 % to 64.7 %" in covers


@pytest.mark.parametrize(
    ("probability", "text"),
    [
        (0.99, "99 %"),
        (0.07, "7 %"),
        (1.0 - 1e-12, "99.9999999999 %"),
        (1.0, "100 %"),
        ([0.5, 0.25], "25 % to 50 %"),
    ],
)
def test_percentages(probability, text):
    assert percent(probability) == text


def test_nearly_all_is_not_all():
    assert percent(np.nextafter(1.0, 0.0)) not in {"100 %", "1e+02 %"}
    assert percent(0.9999, digits=3) == "99.99 %"


@pytest.mark.parametrize("said", [{}, {"share": 0.9}, {"confidence": 0.9}], ids=str)
def test_a_share_needs_its_confidence(said):
    with pytest.raises(UsageError, match="needs both the share and the confidence"):
        Interval(
            kind="share",
            method="bayesian",
            family="normal",
            level=0.99,
            lower=0.0,
            upper=1.0,
            estimate=0.5,
            n=3,
            **said,
        )


def test_the_table_of_a_notebook():
    page = t_interval(X, unit="N/m")._repr_html_()
    assert "64.7 %" in page
    assert "<td>10</td>" in page


def test_a_unit_is_text_and_never_markup():
    page = t_interval(X, unit="<b>N/m</b>")._repr_html_()
    assert "<b>" not in page
    assert page.count("&lt;b&gt;N/m&lt;/b&gt;") == 2  # in its cell, and in the sentence
