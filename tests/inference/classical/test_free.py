import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError
from percept.inference import prediction_interval, t_interval, tolerance_interval
from percept.inference.classical.claims import Claim
from percept.inference.classical.free import least_subjects


@pytest.mark.parametrize(
    ("kind", "claim", "needed"),
    [
        ("share", Claim(share=0.99, confidence=0.95), 473),
        ("share", Claim(share=0.95, confidence=0.95), 93),
        ("share", Claim(share=0.99, confidence=0.95, side="upper"), 299),
        ("user", Claim(0.99), 199),
        ("user", Claim(0.9), 19),
        ("user", Claim(0.9, joint="bonferroni"), 39),
        ("mean", Claim(0.99), 8),
        ("mean", Claim(0.95), 6),
    ],
)
def test_how_many_subjects_it_takes(kind, claim, needed):
    assert least_subjects(kind, claim) == needed


@pytest.mark.parametrize("make", [t_interval, prediction_interval, tolerance_interval])
def test_one_subject_fewer_is_refused_with_the_number(make):
    kind = {"t_interval": "mean", "prediction_interval": "user", "tolerance_interval": "share"}[make.__name__]
    needed = least_subjects(kind, Claim(0.99, share=0.99, confidence=0.95))
    x = np.random.default_rng(1).normal(size=needed)
    interval = make(x, family="free")
    assert (interval.lower, interval.upper) == (x.min(), x.max())
    with pytest.raises(RefusalError, match=f"{needed - 1} subjects are too few .* it takes {needed}"):
        make(x[:-1], family="free")


def test_ranks_against_the_binomial():
    x = np.arange(1.0, 101.0)
    interval = t_interval(x, level=0.95, family="free")
    rank = int(interval.lower)
    assert interval.upper == 101 - rank
    held = stats.binom.cdf(100 - rank, 100, 0.5) - stats.binom.cdf(rank - 1, 100, 0.5)
    assert interval.attained == pytest.approx(held, rel=1e-12)
    assert held >= 0.95 > held - 2 * stats.binom.pmf(rank, 100, 0.5)
    assert interval.estimate == 50.5


def test_share_against_the_binomial():
    x = np.arange(1.0, 1001.0)
    interval = tolerance_interval(x, share=0.9, confidence=0.95, family="free")
    rank = int(interval.lower)

    def confidence(r):  # the interval lacks 2r of 1001 spacings, a count below 2r of users outside
        return stats.binom.sf(2 * r - 1, 1000, 0.1)

    assert interval.attained == pytest.approx(confidence(rank), rel=1e-10)
    assert confidence(rank) >= 0.95 > confidence(rank + 1)


@pytest.mark.parametrize("side", ["both", "lower", "upper"])
def test_the_next_user_whatever_the_distribution(side):
    random = np.random.default_rng(8)
    studies, n = 20_000, 40
    x = random.exponential(size=(studies, n + 1)) ** 3
    interval = prediction_interval(x[:, :n], level=0.9, family="free", side=side)
    newcomer = x[:, n]
    held = np.mean((interval.lower < newcomer) & (newcomer < interval.upper))
    assert interval.attained == pytest.approx(1 - 4 / 41)
    assert abs(held - interval.attained) <= 4 * np.sqrt(0.09 / studies)


def test_a_limit_that_is_not_asked_for_is_infinite():
    x = np.arange(200.0)
    assert prediction_interval(x, family="free", side="lower").upper == np.inf
    assert prediction_interval(x, family="free", side="upper").lower == -np.inf
