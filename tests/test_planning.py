import numpy as np
import pytest
from scipy import integrate, special, stats

from percept.errors import RefusalError, UsageError
from percept.inference import (
    tolerance_factor,
)
from percept.planning import (
    pilot_sds,
    plan_contrast,
    plan_equivalent,
    plan_mean,
    plan_share,
    plan_user,
)

SIZES = range(2, 400)


def fewest(reached, wanted):
    """Return the smallest n that will do, asking every one."""
    return next(n for n in SIZES if reached(n) >= wanted)


def test_widths_against_every_n():
    z = stats.norm.isf(0.025)
    factors = dict(zip(SIZES, tolerance_factor(np.array(SIZES), 0.95, 0.9), strict=True))
    for plan, wanted, factor, sigma in (
        (
            plan_mean(0.5, sd=1.2, level=0.95, assurance=0.9),
            0.5,
            lambda n: stats.t.isf(0.025, n - 1) / np.sqrt(n),
            1.2,
        ),
        (
            plan_user(1.3, level=0.95, assurance=0.9),
            1.3,
            lambda n: stats.t.isf(0.025, n - 1) * np.sqrt(1 + 1 / n),
            1 / z,
        ),
        (
            plan_share(1.3, share=0.95, confidence=0.9, assurance=0.9),
            1.3,
            factors.get,
            1 / z,
        ),
    ):
        # The SD over sigma, times the root of its degrees of freedom, has a chi law.
        def reached(n, wanted=wanted, factor=factor, sigma=sigma):
            return stats.chi.cdf(np.sqrt(n - 1) * wanted / (factor(n) * sigma), n - 1)

        assert plan.n == fewest(reached, 0.9)
        assert plan.assurance == pytest.approx(reached(plan.n), rel=1e-10)
        mean_sd = stats.chi.mean(plan.n - 1) / np.sqrt(plan.n - 1) * sigma
        assert plan.expected == pytest.approx(factor(plan.n) * mean_sd, rel=1e-10)


def test_lognormal_is_a_factor_on_the_log():
    plan = plan_mean(0.1, sd=0.2, family="lognormal")
    log = plan_mean(np.log1p(0.1), sd=np.sqrt(np.log1p(0.04)))
    assert plan.n == log.n
    assert plan.assurance == pytest.approx(log.assurance, rel=1e-13)
    assert np.log1p(plan.expected) == pytest.approx(log.expected, rel=1e-14)


@pytest.mark.parametrize("other_sd", [None, 1.0, 2.0])
def test_contrasts_have_the_power_of_the_noncentral_t(other_sd):
    plan = plan_contrast(0.9, sd=1.0, other_sd=other_sd, level=0.95)
    variances = np.array([1.0] if other_sd is None else [1.0, other_sd**2])
    total = variances.sum()

    def law(n):
        df = total**2 / np.sum(variances**2 / (n - 1))
        return df, stats.t.isf(0.025, df), np.sqrt(total / n)

    def shown(n):
        df, limit, error = law(n)
        return stats.nct.sf(limit, df, 0.9 / error) + stats.nct.cdf(-limit, df, 0.9 / error)

    assert plan.n == fewest(shown, 0.8)
    assert plan.assurance == pytest.approx(shown(plan.n), rel=1e-9)
    df, limit, error = law(plan.n)
    mean_sd = np.exp(special.gammaln((df + 1) / 2) - special.gammaln(df / 2)) * np.sqrt(2 / df)
    assert plan.expected == pytest.approx(limit * error * mean_sd, rel=1e-10)


def test_a_lognormal_contrast_is_one_of_logarithms():
    plan = plan_contrast(0.1, sd=0.2, family="lognormal")
    log = plan_contrast(np.log1p(0.1), sd=np.sqrt(np.log1p(0.04)))
    assert (plan.n, plan.assurance) == (log.n, pytest.approx(log.assurance, rel=1e-12))
    assert np.log1p(plan.expected) == pytest.approx(log.expected, rel=1e-12)
    assert plan.covers == (
        f"With {plan.n} subjects, a difference of 10 % is shown by the 99 % interval in"
        f" {100 * plan.assurance:.4g} % of studies. The interval is within a factor"
        f" {1 + plan.expected:.3g} of the estimate either way on average."
    )


def test_a_pilot_gives_the_sd_of_its_subjects_contrasts():
    left = [1.0, 1.3, 0.8, 1.1, np.nan]
    right = [1.2, 1.4, 1.0, 1.1, 2.0]
    sds, upper = pilot_sds(left, right, within=True, family="lognormal")
    sd = np.log(np.array(right[:4]) / left[:4]).std(ddof=1)
    assert np.log1p(sds[0] ** 2) == pytest.approx(sd**2, rel=1e-13)
    factor = 3.0 / stats.chi2.ppf(0.2, 3)
    assert np.log1p(upper[0] ** 2) == pytest.approx(sd**2 * factor, rel=1e-12)


def test_a_pilot_of_groups_gives_an_sd_for_each():
    novice = [3.0, 4.0, np.nan, 8.0, np.nan]
    expert = [np.nan, np.nan, 1.0, np.nan, 2.0]
    sds, _ = pilot_sds(novice, expert, within=False)
    assert sds == [np.std([3.0, 4.0, 8.0], ddof=1), np.std([1.0, 2.0], ddof=1)]
    plan = plan_contrast(2.0, sd=sds[0], other_sd=sds[1])
    assert plan.covers.startswith(f"With {plan.n} subjects in each group, a diff")
    assert pilot_sds([1.0, np.nan], [np.nan, 2.0], within=False) is None
    assert pilot_sds([1.0, 2.0, 0.1], [2.0, 3.0, 1.1], within=True) is None


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
        (
            lambda: plan_contrast(1.0, sd=1.0, assurance=80.0),
            UsageError,
            "assurance must lie strictly",
        ),
        (lambda: plan_contrast(1e-4, sd=1.0), RefusalError, "More than 10000000 subjects"),
        (lambda: plan_equivalent(0.2, sd=0.1, bias=0.3), UsageError, "smaller than one JND"),
        (lambda: plan_equivalent(0.2, sd=0.0), UsageError, "sd must be a positive number"),
        (lambda: plan_equivalent(0.2, sd=0.1, decision=0.4), UsageError, "between 0.5 and 1"),
        (
            lambda: plan_equivalent(0.2, sd=0.1, assurance=1.0),
            UsageError,
            "assurance must lie strictly",
        ),
        (lambda: plan_user(1.0), UsageError, "ratio must be above 1"),
        (lambda: plan_share(0.9), UsageError, "ratio must be above 1"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(("family", "bias"), [("normal", 0.05), ("lognormal", -0.05)])
def test_subjects_of_an_equivalence_are_the_fewest_that_do(family, bias):
    plan = plan_equivalent(0.2, sd=0.25, bias=bias, assurance=0.7, decision=0.9, family=family)
    log = family == "lognormal"
    sigma = np.sqrt(np.log1p(0.25**2)) if log else 0.25
    limits = np.log([0.8, 1.2]) if log else np.array([-0.2, 0.2])
    centre = np.log1p(bias) if log else bias

    def shown(n):
        t = stats.t.isf(0.1, n - 1)
        low, high = (limits - centre) * np.sqrt(n) / sigma

        def integrand(w):
            density = stats.chi.pdf(w * np.sqrt(n - 1), n - 1) * np.sqrt(n - 1)
            return density * (stats.norm.cdf(high - t * w) - stats.norm.cdf(low + t * w))

        return integrate.quad(integrand, 0.0, (high - low) / (2 * t), limit=200)[0]

    assert shown(plan.n - 1) < 0.7 <= plan.assurance
    assert plan.assurance == pytest.approx(shown(plan.n), rel=1e-7)
    assert f"With {plan.n} subjects, a true bias of" in plan.covers
