import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference import (
    prediction_interval,
    t_interval,
    tolerance_factor,
    tolerance_interval,
)
from percept.planning import (
    plan_contrast,
    plan_equivalent,
    plan_from_pilot,
    plan_mean,
    plan_share,
    plan_user,
)
from tests import LONG


def brute_force(reached, assurance):
    """Return the smallest n that will do, asking every one; and whether it stays so."""
    chances = [reached(n) for n in range(2, 400)]
    first = next(i for i, chance in enumerate(chances) if chance >= assurance)
    return first + 2, all(chance >= assurance for chance in chances[first:])


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


#: Of 5 % tests with both sides: G*Power 3.1, "Means: difference between two dependent means" and
#: "between two independent means"; the first column of n is of pairs, the second of each group.
PUBLISHED = [
    (0.2, 0.8, 199, 394),
    (0.5, 0.8, 34, 64),
    (0.8, 0.8, 15, 26),
    (0.5, 0.9, 44, 86),
    (0.8, 0.9, 19, 34),
]


@pytest.mark.parametrize(("size", "power", "pairs", "each"), PUBLISHED)
def test_contrasts_need_the_published_numbers(size, power, pairs, each):
    options = {"level": 0.95, "power": power}
    assert plan_contrast(size, sd=1.0, **options).n == pairs
    assert plan_contrast(3.0 * size, sd=3.0, other_sd=3.0, **options).n == each


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("other_sd", [None, 1.0, 2.0])
def test_simulated_contrasts_show_the_difference_as_often_as_planned(other_sd):
    random = np.random.default_rng(7)
    studies = 40_000 if LONG else 4_000
    plan = plan_contrast(0.9, sd=1.0, other_sd=other_sd, level=0.95)
    first = random.normal(size=(studies, plan.n))
    if other_sd is None:
        interval = stats.ttest_1samp(first + 0.9, 0.0, axis=1).confidence_interval(0.95)
    else:
        second = 0.9 + other_sd * random.normal(size=(studies, plan.n))
        test = stats.ttest_ind(second, first, axis=1, equal_var=False)
        interval = test.confidence_interval(0.95)
    shows = np.mean((interval.low > 0.0) | (interval.high < 0.0))
    error = np.sqrt(plan.power * (1.0 - plan.power) / studies)
    # Satterthwaite's degrees of freedom are estimated by each study, which costs .005 at most here.
    assert abs(shows - plan.power) <= 4.0 * error + (0.005 if other_sd else 0.0)
    half = (interval.high - interval.low) / 2.0
    allowed = 4.0 * half.std() / np.sqrt(studies) + (0.005 if other_sd else 0.0)
    assert abs(half.mean() - plan.expected) <= allowed


def test_a_lognormal_contrast_is_one_of_logarithms():
    plan = plan_contrast(0.1, sd=0.2, family="lognormal")
    log = plan_contrast(np.log1p(0.1), sd=np.sqrt(np.log1p(0.04)))
    assert (plan.n, plan.power) == (log.n, pytest.approx(log.power, rel=1e-12))
    assert np.log1p(plan.expected) == pytest.approx(log.expected, rel=1e-12)
    assert plan.covers == (
        f"With {plan.n} subjects, a difference of 10 % is shown by the 99 % interval in"
        f" {100 * plan.power:.4g} % of studies. The interval is within a factor"
        f" {1 + plan.expected:.3g} of the estimate either way on average."
    )


def test_a_pilot_gives_the_sd_of_its_subjects_contrasts():
    left = [1.0, 1.3, 0.8, 1.1, np.nan]
    right = [1.2, 1.4, 1.0, 1.1, 2.0]
    pilot = plan_from_pilot(left, right, 0.1, within=True, level=0.95, family="lognormal")
    sd = np.log(np.array(right[:4]) / left[:4]).std(ddof=1)
    assert pilot.plan.n == plan_contrast(np.log1p(0.1), sd=sd, level=0.95).n
    upper = sd * np.sqrt(3.0 / stats.chi2.ppf(0.2, 3))
    assert pilot.cautious.n == plan_contrast(np.log1p(0.1), sd=upper, level=0.95).n
    assert pilot.subjects == 4


def test_a_pilot_of_groups_gives_an_sd_for_each():
    novice = [3.0, 4.0, np.nan, 8.0, np.nan]
    expert = [np.nan, np.nan, 1.0, np.nan, 2.0]
    pilot = plan_from_pilot(novice, expert, 2.0, within=False)
    sds = {"sd": np.std([3.0, 4.0, 8.0], ddof=1), "other_sd": np.std([1.0, 2.0], ddof=1)}
    assert pilot.plan == plan_contrast(2.0, **sds)
    assert pilot.plan.covers.startswith(f"With {pilot.plan.n} subjects in each group, a diff")
    assert plan_from_pilot([1.0, np.nan], [np.nan, 2.0], 2.0, within=False) is None
    assert plan_from_pilot([1.0, 2.0, 0.1], [2.0, 3.0, 1.1], 2.0, within=True) is None


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
        (lambda: plan_contrast(0.0, sd=1.0), UsageError, "difference must be a positive"),
        (lambda: plan_contrast(1.0, sd=1.0, other_sd=-1.0), UsageError, "other_sd must be"),
        (lambda: plan_contrast(1.0, sd=1.0, power=80.0), UsageError, "power must lie strictly"),
        (lambda: plan_contrast(1e-4, sd=1.0), RefusalError, "More than 10000000 subjects"),
        (lambda: plan_user(1.0), UsageError, "ratio must be above 1"),
        (lambda: plan_share(0.9), UsageError, "ratio must be above 1"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(("family", "bias"), [("normal", 0.05), ("lognormal", -0.05)])
def test_subjects_of_an_equivalence_are_the_fewest_that_do(family, bias):
    plan = plan_equivalent(0.2, sd=0.25, bias=bias, power=0.7, decision=0.9, family=family)
    log = family == "lognormal"
    sigma = np.sqrt(np.log1p(0.25**2)) if log else 0.25
    limits = np.log([0.8, 1.2]) if log else np.array([-0.2, 0.2])
    centre = np.log1p(bias) if log else bias
    rng = np.random.default_rng(7)
    studies = 40_000
    shares = []
    for n in (plan.n - 1, plan.n):
        mean = centre + sigma / np.sqrt(n) * rng.standard_normal(studies)
        error = sigma * np.sqrt(rng.chisquare(n - 1, studies) / (n - 1) / n)
        reach = stats.t.isf(0.1, n - 1) * error
        shares.append(np.mean((mean - reach > limits[0]) & (mean + reach < limits[1])))
    noise = 4.0 * np.sqrt(0.7 * 0.3 / studies)
    assert abs(shares[1] - plan.power) < noise
    assert shares[0] < 0.7 + noise
    assert plan.power >= 0.7
    assert f"With {plan.n} subjects, a true bias of" in plan.covers


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bias": 0.3}, "bias must be smaller than one JND"),
        ({"sd": 0.0}, "sd must be a positive number"),
        ({"decision": 0.4}, "decision must lie strictly between 0.5 and 1"),
        ({"power": 1.0}, "power must lie strictly between 0 and 1"),
    ],
)
def test_an_equivalence_that_no_study_shows(options, message):
    with pytest.raises(UsageError, match=message):
        plan_equivalent(0.2, **{"sd": 0.1} | options)
