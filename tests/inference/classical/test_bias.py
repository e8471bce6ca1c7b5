import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference import Moments, bias, equivalence_test, t_interval

X = np.random.default_rng(2).lognormal(np.log(9.0), 0.1, 12)


@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_bias_is_the_interval_over_the_reference(family):
    found, interval = bias(X, 10.0, family=family), t_interval(X, family=family)
    assert (found.ratio, found.lower, found.upper) == pytest.approx(
        (interval.estimate / 10, interval.lower / 10, interval.upper / 10), rel=1e-15
    )


def test_six_of_ten_published_references_lie_outside():
    lower = np.array([10.808, 0.0356, 944.85, 1.2404, 8979.9, 8.188, 23316, 21.447, 39498, 79.933])
    upper = np.array([19.02, 1.3335, 1017.2, 1.5316, 9954.1, 13.146, 24968, 27.549, 47829, 112.34])
    reference = np.array([10, 0.1, 1000, 1, 10000, 10, 25000, 25, 50000, 50.0])
    found = bias(Moments.from_limits(lower, upper, 10), reference)
    assert found.holds_reference.tolist() == [
        False,
        True,
        True,
        False,
        False,
        True,
        False,
        True,
        False,
        False,
    ]
    assert found.lower == pytest.approx(lower / reference, rel=1e-14)


def test_published_moments_under_lognormal_are_approximate():
    published = Moments(10.0, 2.0, 10)
    assert bias(published, 9.0, family="lognormal").approximate
    assert not bias(published, 9.0).approximate


def test_equivalence_against_two_t_tests():
    margin, alpha = 0.15, 0.05
    for family, y, least, most in (
        ("normal", X / 10, 0.85, 1.15),
        ("lognormal", np.log(X / 10), -np.log(1.15), np.log(1.15)),
    ):
        found = equivalence_test(X, 10.0, margin=margin, alpha=alpha, family=family)
        above = stats.ttest_1samp(y, least, alternative="greater").pvalue
        below = stats.ttest_1samp(y, most, alternative="less").pvalue
        assert found.p_value == pytest.approx(max(above, below), rel=1e-10)
        assert found.equivalent == (max(above, below) < alpha)
        inside = (found.bias.lower > found.least) & (found.bias.upper < found.most)
        assert found.equivalent == inside
        assert found.bias.level == 0.9


@pytest.mark.parametrize("family", ["normal", "lognormal"])
def test_at_the_edge_of_the_margin_the_test_has_its_size(family):
    random = np.random.default_rng(3)
    studies, alpha = 20_000, 0.05
    edge = 1.1
    drawn = random.normal(0.0, 0.02, (studies, 8))
    x = edge * np.exp(drawn) if family == "lognormal" else edge + drawn
    rate = np.mean(equivalence_test(x, 1.0, margin=0.1, alpha=alpha, family=family).equivalent)
    assert abs(rate - alpha) <= 4 * np.sqrt(alpha * (1 - alpha) / studies)


def test_sentences():
    assert bias(X, 10.0).covers == (
        "The average user's value divided by the reference lies between the limits, with 99 % confidence."
    )
    assert equivalence_test(X, 10.0, margin=0.25, family="lognormal").covers == (
        "Equivalent means: the typical (geometric-mean) user's value is shown to lie between 0.8 and 1.25 "
        "times the reference, with an error rate of at most 5 %."
    )


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: bias(X, 0.0), RefusalError, "zero or below has no ratio"),
        (lambda: bias(X, [1.0, 2.0]), UsageError, r"references of shape \(2,\) for samples of shape \(\)"),
        (lambda: bias([X, X, X], [1.0, 2.0]), UsageError, r"shape \(2,\) for samples of shape \(3,\)"),
        (lambda: bias(X, np.nan), UsageError, "references must be finite"),
        (lambda: bias(X, 1.0, family="free"), UsageError, '"normal" or "lognormal"'),
        (lambda: equivalence_test(X, 10.0, margin=0.0), UsageError, "margin must be a positive"),
        (lambda: equivalence_test(X, 10.0, margin=1.0), UsageError, "below 1 for the normal family"),
        (lambda: equivalence_test(X, 10.0, margin=0.1, alpha=0.5), UsageError, "between 0 and 0.5"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
