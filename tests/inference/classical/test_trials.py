import numpy as np
import pytest

from percept.errors import RefusalError, UsageError
from percept.inference import Moments, subject_means, t_interval

TRIALS = np.array([3.0, 10.0, 5.0, 7.0, 12.0, 6.0])
WHO = np.array(["b", "a", "b", "c", "a", "b"])


def test_n_is_subjects_each_counting_once():
    found = subject_means(TRIALS, WHO)
    assert found.subjects == ("b", "a", "c")
    assert found.trials.tolist() == [3, 2, 1]
    assert found.values == pytest.approx([14 / 3, 11.0, 7.0], rel=1e-15)
    interval = t_interval(found.moments())
    assert interval.n == 3
    assert interval.repeats
    assert interval.mean == pytest.approx((14 / 3 + 11 + 7) / 3, rel=1e-15)
    assert found.rule == "Each subject counts once, by the mean of their 1 to 3 trials."


def test_the_pooled_sd_between_trials():
    within = [np.array([3.0, 5.0, 6.0]), np.array([10.0, 12.0]), np.array([7.0])]
    squares = sum(((part - part.mean()) ** 2).sum() for part in within)
    assert subject_means(TRIALS, WHO).trial_sd == pytest.approx(np.sqrt(squares / 3), rel=1e-14)


def test_lognormal_averages_logarithms():
    found = subject_means(TRIALS, WHO, family="lognormal")
    assert found.values == pytest.approx([90 ** (1 / 3), np.sqrt(120.0), 7.0], rel=1e-14)
    assert found.moments().scale == "log"
    assert found.moments().mean == pytest.approx(np.log(found.values).mean(), rel=1e-14)
    assert "geometric mean" in found.rule


def test_one_trial_each_has_no_sd_between_trials():
    found = subject_means([1.0, 2.0, 4.0], [3, 1, 2])
    assert found.trial_sd is None
    assert found.moments().repeats is False
    assert found.rule == "One trial per subject."


def test_weights_by_trials_or_by_hand():
    found = subject_means(TRIALS, WHO)
    by_trials = found.moments(weights="trials")
    assert by_trials.mean == pytest.approx(TRIALS.mean(), rel=1e-14)
    assert by_trials.weighted
    assert by_trials.repeats
    by_hand = found.moments(weights=[3.0, 2.0, 1.0])
    assert (by_hand.mean, by_hand.sd) == (by_trials.mean, by_trials.sd)
    reference = Moments.from_weighted(found.values, [3.0, 2.0, 1.0])
    assert by_trials.sd == reference.sd


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: subject_means(TRIALS, WHO[:5]), UsageError, r"One subject per trial .* \(6,\) and \(5,\)"),
        (lambda: subject_means([], []), UsageError, "array is empty"),
        (lambda: subject_means([1.0, 2.0], [np.nan, 1.0]), UsageError, "every trial needs a subject"),
        (lambda: subject_means([1.0, 2.0], [None, "a"]), UsageError, "every trial needs a subject"),
        (lambda: subject_means([1.0, 0.0], [1, 2], family="lognormal"), RefusalError, "zero or negative"),
        (lambda: subject_means(TRIALS, WHO, family="free"), UsageError, '"normal" or "lognormal"'),
        (lambda: subject_means(TRIALS, WHO).moments(weights="some"), UsageError, 'weights must be "equal"'),
        (lambda: subject_means([1.0, 2.0], ["a", "a"]).moments(), RefusalError, "At least 2 subjects"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
