import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference import (
    EllipseRegion,
    Moments,
    RectangleRegion,
    ellipse_region,
    prediction_interval,
    rectangle_region,
    t_interval,
    tolerance_interval,
)

RANDOM = np.random.default_rng(21)
COVARIANCE = np.array([[4.0, 1.2], [1.2, 1.0]])
K, B = RANDOM.multivariate_normal([30.0, 10.0], COVARIANCE, 10).T


@pytest.mark.parametrize("kind", ["mean", "user"])
@pytest.mark.parametrize("n", [3, 4, 10, 50])
def test_the_radius_is_hotellings(kind, n):
    k, b = RANDOM.normal(size=(2, n))
    region = ellipse_region(k, b, kind=kind, level=0.95)
    f = stats.f.isf(1.0 - 0.95, 2, n - 2)
    t2 = 2 * (n - 1) / (n - 2) * f
    assert region.radius**2 == pytest.approx(t2 * (1 / n if kind == "mean" else 1 + 1 / n), rel=1e-12)
    assert region.shape == pytest.approx(np.cov(k, b), rel=1e-12)


def test_distance_and_curve_against_linear_algebra():
    region = ellipse_region(K, B, kind="user")
    inverse = np.linalg.inv(np.cov(K, B))
    points = np.array([K, B]) - np.array([[K.mean()], [B.mean()]])
    dense = np.sqrt(np.einsum("ij,ik,kj->j", points, inverse, points))
    assert region.distance(K, B) == pytest.approx(dense, rel=1e-12)
    k, b = region.curve(np.linspace(0, 2 * np.pi, 721))
    assert region.distance(k, b) == pytest.approx(np.full(721, region.radius), rel=1e-12)
    (k_low, k_high), (b_low, b_high) = region.limits()
    assert (k.min(), k.max()) == pytest.approx((k_low, k_high), rel=1e-4)
    assert (b.min(), b.max()) == pytest.approx((b_low, b_high), rel=1e-4)
    assert (k.min() >= k_low) & (b.max() <= b_high)


def test_lognormal_is_the_ellipse_of_the_logarithms():
    region = ellipse_region(K, B, kind="user", family="lognormal")
    log = ellipse_region(np.log(K), np.log(B), kind="user")
    k, b = region.curve([0.3, 2.0])
    assert np.log(k) == pytest.approx(log.curve([0.3, 2.0])[0], rel=1e-14)
    assert region.distance(k, b) == pytest.approx([region.radius] * 2, rel=1e-12)
    assert region.limits()[0] == pytest.approx(np.exp(log.limits()[0]), rel=1e-14)
    assert region.distance([-1.0, 30.0, 0.0], [1.0, 0.0, -1.0]).tolist() == [np.inf] * 3
    assert not region.contains(-1.0, 10.0)


def test_an_offset_does_not_round_the_correlation():
    x, y = np.arange(8.0), np.array([1.0, 3, 2, 5, 4, 7, 6, 9])
    near = ellipse_region(x, y, kind="mean")
    far = ellipse_region(x + 1e15, y + 1e15, kind="mean")
    assert far.shape == pytest.approx(near.shape, rel=1e-13)


@pytest.mark.parametrize("kind", ["mean", "user"])
def test_each_treatment_holds_both_at_the_level_it_states(kind):
    random = np.random.default_rng(31)
    studies, n, level = 2500, 8, 0.9
    held = {"marginal": 0, "bonferroni": 0, "hotelling": 0}
    for study in range(1, studies + 1):
        drawn = random.multivariate_normal([30.0, 10.0], COVARIANCE, n + 1)
        k, b = drawn[:n].T
        target = drawn[n] if kind == "user" else (30.0, 10.0)
        for joint in held:
            if joint == "hotelling":
                region = ellipse_region(k, b, kind=kind, level=level)
            else:
                region = rectangle_region(k, b, kind=kind, level=level, joint=joint)
            held[joint] += bool(region.contains(*target))
            least, most = region.joint_level
            expected = {"marginal": (0.8, 0.9), "bonferroni": (0.9, 0.95), "hotelling": (0.9, 0.9)}[joint]
            assert (least, most) == pytest.approx(expected)
            error = 4 * np.sqrt(least * (1 - least) / studies)
            if study == studies:
                assert least - error <= held[joint] / studies <= most + error


def test_a_rectangle_is_its_two_intervals():
    region = rectangle_region(K, B, kind="mean", joint="bonferroni")
    assert region.stiffness.lower == t_interval(K, joint="bonferroni").lower
    assert region.contains(region.stiffness.lower, region.damping.upper)
    assert not region.contains(np.nextafter(region.stiffness.lower, -np.inf), region.damping.upper)
    assert (region.kind, region.method, region.family, region.joint) == (
        "mean",
        "classical",
        "normal",
        "bonferroni",
    )


def test_two_intervals_of_a_low_level_may_hold_nothing_together():
    assert rectangle_region(K, B, kind="mean", level=0.4).joint_level == (0.0, 0.4)


def test_published_limits_make_a_rectangle():
    k, b = Moments.from_limits(944.85, 1017.2, 10), Moments.from_limits(1.2404, 1.5316, 10)
    region = rectangle_region(k, b, kind="mean")
    assert region.joint_level == pytest.approx((0.98, 0.99))
    assert not region.contains(1000.0, 1.0)


def test_a_share_states_share_and_confidence():
    marginal = rectangle_region(K, B, kind="share")
    assert marginal.joint_level == pytest.approx((0.9, 0.95))
    assert marginal.joint_share == pytest.approx((0.98, 0.99))
    assert marginal.covers == (
        "At least 98 % of all users lie inside with both values, with 90 % to 95 % confidence."
    )
    joint = rectangle_region(K, B, kind="share", joint="bonferroni")
    assert joint.joint_level == pytest.approx((0.95, 0.975))
    assert joint.joint_share == pytest.approx((0.99, 0.995))


def test_sentences():
    assert rectangle_region(K, B, kind="mean").covers == (
        "The average user's stiffness and damping lie inside together, with 98 % to 99 % confidence."
    )
    assert ellipse_region(K, B, kind="user").covers == (
        "The next user's stiffness and damping lie inside together, with 99 % confidence (from 10 users)."
    )
    assert ellipse_region(K, B, kind="mean", family="lognormal").covers == (
        "The typical (geometric-mean) user's stiffness and damping lie inside together, with 99 % confidence "
        "(from 10 users)."
    )
    assert ellipse(np.zeros(2), np.eye(2)).covers == (
        "The average user's stiffness and damping lie inside together, with 90 % probability under the model "
        "and its priors (from 3 users)."
    )


LINE = np.arange(5.0)


def ellipse(centre, shape):
    return EllipseRegion(
        kind="mean",
        method="bayesian",
        family="normal",
        level=0.9,
        centre=centre,
        shape=shape,
        radius=1.0,
        n=3,
    )


def test_the_curve_itself_is_inside():
    circle = ellipse(np.zeros(2), np.eye(2))
    assert circle.contains([1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]).all()
    assert not circle.contains(np.nextafter(1.0, 2.0), 0.0)


def test_points_on_a_line_but_for_rounding_are_refused():
    for seed in range(50):
        k = np.random.default_rng(seed).normal(30.0, 2.0, 10)
        with pytest.raises(RefusalError, match="lie on a line"):
            ellipse_region(k, 0.1 * k + 0.3, kind="mean")


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: ellipse_region(K, B, kind="share"), RefusalError, "no exact ellipse of a share"),
        (lambda: ellipse_region(K, B, kind="all"), UsageError, 'kind must be "mean" or "user"'),
        (
            lambda: ellipse_region(K, B, kind="mean", family="free"),
            UsageError,
            '"normal" or "lognormal" here',
        ),
        (lambda: ellipse_region(Moments(1, 1, 5), B, kind="mean"), RefusalError, "go together"),
        (lambda: ellipse_region(K, B[:9], kind="mean"), UsageError, r"\(10,\), \(9,\)"),
        (lambda: ellipse_region(K[:2], B[:2], kind="mean"), RefusalError, "At least 3 subjects"),
        (lambda: ellipse_region(LINE, 3 * LINE, kind="mean"), RefusalError, "lie on a line"),
        (lambda: ellipse_region(LINE, 0 * LINE, kind="mean"), RefusalError, "no scatter"),
        (lambda: ellipse_region(-K, B, kind="mean", family="lognormal"), RefusalError, "zero or negative"),
        (lambda: ellipse_region(K, B, kind="mean", level=[0.9]), UsageError, "must be one number"),
        (lambda: rectangle_region(K, B, kind="all"), UsageError, 'kind must be "mean", "user" or "share"'),
        (lambda: rectangle_region([K, K], [B, B], kind="mean"), UsageError, "of one environment"),
        (
            lambda: RectangleRegion(stiffness=t_interval(K), damping=prediction_interval(B)),
            UsageError,
            "differ in kind: 'mean' and 'user'",
        ),
        (
            lambda: RectangleRegion(
                stiffness=tolerance_interval(K, share=0.9), damping=tolerance_interval(B, share=0.8)
            ),
            UsageError,
            r"differ in share: 0\.9 and 0\.8",
        ),
        (
            lambda: RectangleRegion(
                stiffness=tolerance_interval(K, confidence=0.9), damping=tolerance_interval(B, confidence=0.8)
            ),
            UsageError,
            r"differ in confidence: 0\.9 and 0\.8",
        ),
        (lambda: ellipse(np.zeros(3), np.eye(2)), UsageError, r"got \(3,\)"),
        (lambda: ellipse(np.zeros(2), np.ones((2, 2))), UsageError, "positive definite"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
