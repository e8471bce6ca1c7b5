import numpy as np
import pytest
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference.regions import ellipse_region

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
    assert region.radius**2 == pytest.approx(
        t2 * (1 / n if kind == "mean" else 1 + 1 / n), rel=1e-12
    )
    assert region.shape == pytest.approx(np.cov(k, b), rel=1e-12)


def test_distance_against_linear_algebra():
    region = ellipse_region(K, B, kind="user")
    inverse = np.linalg.inv(np.cov(K, B))
    points = np.array([K, B]) - np.array([[K.mean()], [B.mean()]])
    dense = np.sqrt(np.einsum("ij,ik,kj->j", points, inverse, points))
    assert region.distance(K, B) == pytest.approx(dense, rel=1e-12)


def test_lognormal_is_the_ellipse_of_the_logarithms():
    region = ellipse_region(K, B, kind="user", family="lognormal")
    log = ellipse_region(np.log(K), np.log(B), kind="user")
    assert region.distance(K, B) == pytest.approx(log.distance(np.log(K), np.log(B)), rel=1e-12)
    assert region.radius == log.radius
    assert region.distance([-1.0, 30.0, 0.0], [1.0, 0.0, -1.0]).tolist() == [np.inf] * 3


def test_an_offset_does_not_round_the_correlation():
    x, y = np.arange(8.0), np.array([1.0, 3, 2, 5, 4, 7, 6, 9])
    near = ellipse_region(x, y, kind="mean")
    far = ellipse_region(x + 1e15, y + 1e15, kind="mean")
    assert far.shape == pytest.approx(near.shape, rel=1e-13)


LINE = np.arange(5.0)


def test_points_on_a_line_but_for_rounding_are_refused():
    for seed in range(50):
        k = np.random.default_rng(seed).normal(30.0, 2.0, 10)
        with pytest.raises(RefusalError, match="lie on a line"):
            ellipse_region(k, 0.1 * k + 0.3, kind="mean")


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: ellipse_region(K, B, kind="share"),
            UsageError,
            'kind must be one of "mean", "user"',
        ),
        (
            lambda: ellipse_region(K, B, kind="mean", family="free"),
            UsageError,
            "family must be one of",
        ),
        (lambda: ellipse_region(K, B[:9], kind="mean"), UsageError, r"\(10,\), \(9,\)"),
        (lambda: ellipse_region(K[:2], B[:2], kind="mean"), RefusalError, "At least 3 subjects"),
        (lambda: ellipse_region(LINE, 3 * LINE, kind="mean"), RefusalError, "lie on a line"),
        (lambda: ellipse_region(LINE, 0 * LINE, kind="mean"), RefusalError, "no scatter"),
        (
            lambda: ellipse_region(-K, B, kind="mean", family="lognormal"),
            RefusalError,
            "zero or negative",
        ),
        (lambda: ellipse_region(K, B, kind="mean", level=[0.9]), UsageError, "must be one number"),
    ],
)
def test_what_is_wrong_is_said(call, error, message):
    with pytest.raises(error, match=message):
        call()
