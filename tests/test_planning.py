import numpy as np
import pytest
from scipy import special, stats

from percept.errors import RefusalError, UsageError
from percept.inference import (
    Moments,
    prediction_interval,
    t_interval,
    tolerance_factor,
    tolerance_interval,
)
from percept.planning import plan_mean, plan_share, plan_user
from tests import LONG


def brute_force(reached, assurance):
    """Return the smallest n that will do, asking every one; and whether it stays so."""
    chances = [reached(n) for n in range(2, 400)]
    first = next(i for i, chance in enumerate(chances) if chance >= assurance)
    return first + 2, all(chance >= assurance for chance in chances[first:])


@pytest.mark.parametrize("wanted", [0.25, 0.5, 1.0, 5.0, 1000.0])
@pytest.mark.parametrize("assurance", [0.2, 0.5, 0.8, 0.99])
def test_mean_against_every_n(wanted, assurance):
    def reached(n):
        half_width = stats.t.isf(0.005, n - 1) / np.sqrt(n)
        return stats.chi2.cdf((n - 1) * (wanted / half_width) ** 2, n - 1)

    n, monotone = brute_force(reached, assurance)
    plan = plan_mean(wanted * 3.0, sd=3.0, assurance=assurance)
    assert monotone
    assert plan.n == n
    assert plan.assurance == pytest.approx(reached(n), rel=1e-10)


def test_user_and_share_against_every_n():
    z = stats.norm.isf(0.025)

    def user(n):
        return stats.chi2.cdf(
            (n - 1) * (1.3 * z / stats.t.isf(0.025, n - 1)) ** 2 / (1 + 1 / n), n - 1
        )

    factors = dict(zip(range(2, 400), tolerance_factor(np.arange(2, 400), 0.95, 0.9), strict=True))

    def share(n):
        return stats.chi2.cdf((n - 1) * (1.3 * z / factors[n]) ** 2, n - 1)

    for reached, plan in (
        (user, plan_user(1.3, level=0.95, assurance=0.9)),
        (share, plan_share(1.3, share=0.95, confidence=0.9, assurance=0.9)),
    ):
        assert brute_force(reached, 0.9) == (plan.n, True)
        assert plan.assurance == pytest.approx(reached(plan.n), rel=1e-10)


@pytest.mark.evidence(reduced=True)
def test_simulated_studies_reach_the_width_as_often_as_assured():
    random = np.random.default_rng(12)
    studies = 20_000 if LONG else 2_000
    for plan, make, z, options in (
        (plan_mean(0.5, sd=1.0, level=0.95), t_interval, 1.0, {"level": 0.95}),
        (plan_user(1.4, level=0.95), prediction_interval, stats.norm.isf(0.025), {"level": 0.95}),
        (plan_share(1.5, share=0.9), tolerance_interval, stats.norm.isf(0.05), {"share": 0.9}),
    ):
        interval = make(random.normal(size=(studies, plan.n)), **options)
        widths = (interval.upper - interval.lower) / 2 / z
        error = np.sqrt(plan.assurance * (1 - plan.assurance) / studies)
        assert abs(np.mean(widths <= plan.wanted) - plan.assurance) <= 4 * error
        assert abs(widths.mean() - plan.expected) <= 4 * widths.std() / np.sqrt(studies)


def test_lognormal_is_a_factor_on_the_log():
    plan = plan_mean(0.1, sd=0.2, family="lognormal")
    log = plan_mean(np.log1p(0.1), sd=np.sqrt(np.log1p(0.04)))
    assert plan.n == log.n
    assert plan.assurance == pytest.approx(log.assurance, rel=1e-13)
    assert np.log1p(plan.expected) == pytest.approx(log.expected, rel=1e-14)


def test_the_planned_width_is_that_of_the_interval():
    plan = plan_mean(0.4, sd=1.0)
    c4 = np.sqrt(2 / (plan.n - 1)) * np.exp(
        special.gammaln(plan.n / 2) - special.gammaln((plan.n - 1) / 2)
    )
    assert plan.expected == pytest.approx(t_interval(Moments(0.0, c4, plan.n)).upper, rel=1e-13)


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (plan_mean(0.5, sd=1.0), "the 99 % interval of the average user is at most ± 0.5 wide"),
        (
            plan_mean(0.5, sd=1.0, level=0.95, family="lognormal"),
            (
                "the 95 % interval of the average user is within a factor 1.5 of the estimate"
                " either way"
            ),
        ),
        (
            plan_user(1.5),
            (
                "the 99 % interval of the next user is at most 1.5 times as wide as that of a known"
                " population"
            ),
        ),
        (
            plan_share(1.5, share=0.9),
            (
                "the interval of 90 % of all users, with 95 % confidence, is at most 1.5 times as"
                " wide as that of a known population"
            ),
        ),
    ],
)
def test_sentence(plan, said):
    assert (
        plan.covers == f"With {plan.n} subjects, {said} in {100 * plan.assurance:.4g} % of studies."
    )


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: plan_mean(0.0, sd=1.0), UsageError, "half_width must be a positive"),
        (lambda: plan_mean(np.inf, sd=1.0), UsageError, "half_width must be a positive"),
        (lambda: plan_mean(1.0, sd=np.nan), UsageError, "sd must be a positive"),
        (lambda: plan_mean(1.0, sd=np.inf), UsageError, "sd must be a positive"),
        (lambda: plan_mean(1.0, sd=1.0, assurance=1.0), UsageError, "assurance must lie strictly"),
        (lambda: plan_mean(1.0, sd=1.0, level=0.0), UsageError, "level must lie strictly"),
        (lambda: plan_mean(1.0, sd=1.0, family="free"), UsageError, '"normal", "lognormal"'),
        (lambda: plan_mean(1e-5, sd=1.0), RefusalError, "More than 10000000 subjects"),
        (lambda: plan_user(1.0), UsageError, "ratio must be above 1"),
        (lambda: plan_share(0.9), UsageError, "ratio must be above 1"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
