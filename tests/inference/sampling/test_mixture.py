"""Endpoints of mixtures against 30-digit roots, their influence against reweighted roots."""

import numpy as np
import pytest
from mpmath import mp
from scipy import integrate, optimize, special, stats

from percept.inference.sampling.endpoints import mixture_limits, share_content, share_half_width

MIXTURES = {
    "alike": lambda rng: (0.1 * rng.normal(size=40), np.exp(0.2 * rng.normal(size=40))),
    "apart": lambda rng: (10.0 * rng.normal(size=40), np.exp(0.5 * rng.normal(size=40))),
    "unequal": lambda rng: (rng.normal(size=40), np.exp(2.0 * rng.normal(size=40))),
    "tiny on an offset": lambda rng: (
        1e3 + 1e-6 * rng.normal(size=40),
        1e-6 * np.exp(rng.normal(size=40)),
    ),
    "one": lambda rng: (np.array([0.3]), np.array([2.0])),
}


@pytest.mark.parametrize("tail", [0.5, 0.1, 0.005, 1e-6, 1e-12])
@pytest.mark.parametrize("mixture", MIXTURES)
def test_quantile_is_the_root(mixture, tail):
    mean, sd = MIXTURES[mixture](np.random.default_rng(1))
    for upper in (False, True):
        found = mixture_limits(mean[:, None], sd[:, None], tail)[upper][0]
        sign = 1 if upper else -1
        with mp.workdps(30):
            components = [
                (mp.mpf(float(m)), mp.mpf(float(s))) for m, s in zip(mean, sd, strict=True)
            ]

            def beyond(x, components=components, sign=sign):
                return mp.fsum(
                    mp.erfc(sign * (x - m) / s / mp.sqrt(2)) / 2 for m, s in components
                ) / len(mean)

            slope = mp.fsum(mp.npdf(mp.mpf(float(found)), m, s) for m, s in components) / len(mean)
            error = (beyond(mp.mpf(float(found))) - mp.mpf(tail)) / slope
            scale = max(abs(float(found)) * 1e-3, float(np.std(mean) + sd.max()) * 1e-3, 1e-300)
            assert abs(float(error)) < 1e-10 * scale + 4e-16 * abs(float(found))


def weighted_root(function, weights, low, high):
    return optimize.brentq(lambda x: weights @ function(x), low, high, xtol=1e-14, rtol=1e-14)


def assert_derivatives(influence, limits):
    """Compare influences (S, ...) with changes of limits where a draw weighs a little more."""
    count = len(influence)
    step = 1e-4
    for s in (0, 6, 13):
        ends = []
        for change in (step, -step):
            weights = np.full(count, (1 - change) / count)
            weights[s] += change
            ends.append(limits(weights))
        derivative = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(influence[s], derivative, atol=1e-4 * np.abs(influence).max())


@pytest.mark.parametrize("upper", [True, False])
def test_influence_is_the_derivative_in_a_draw_s_weight(upper):
    rng = np.random.default_rng(4)
    mean, sd = rng.normal(size=30), np.exp(0.5 * rng.normal(size=30))
    influence = mixture_limits(mean[:, None], sd[:, None], 0.005)[2][:, int(upper)]
    assert abs(influence.mean()) < 1e-12
    below = 0.995 if upper else 0.005

    def root(weights):
        return weighted_root(lambda x: special.ndtr((x - mean) / sd) - below, weights, -20, 20)

    assert_derivatives(influence, root)


def exact_content(h, centre, mean, sd, spread, share):
    """P(the interval holds the share) of one draw, by quadrature over the population's mean."""

    def inside(beta):
        return (
            stats.norm.cdf(centre + h, beta, spread)
            - stats.norm.cdf(centre - h, beta, spread)
            - share
        )

    if inside(centre) <= 0:
        return 0.0
    reach = optimize.brentq(lambda d: inside(centre + d), 0, h + 40 * spread, xtol=1e-15)
    return integrate.quad(
        lambda b: stats.norm.pdf(b, mean, sd),
        centre - reach,
        centre + reach,
        epsabs=1e-13,
        points=[mean],
        limit=200,
    )[0]


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 0.999])
def test_share_content_and_half_width(share):
    rng = np.random.default_rng(5)
    mean, sd = 0.2 * rng.normal(size=25), 0.3 * np.exp(0.3 * rng.normal(size=25))
    spread = np.exp(0.4 * rng.normal(size=25))
    packed = mean[:, None], sd[:, None], spread[:, None]
    centre, half, influence = share_half_width(*packed, share=share, confidence=0.95)
    assert abs(centre[0] - mean.mean()) < 1e-15
    contents = [
        exact_content(half[0], centre[0], m, s, t, share)
        for m, s, t in zip(mean, sd, spread, strict=True)
    ]
    np.testing.assert_allclose(
        share_content(half, centre, *packed, share)[0][:, 0], contents, atol=2e-10
    )
    assert abs(np.mean(contents) - 0.95) < 1e-10
    assert np.all(np.abs(influence.mean(axis=0)) < 1e-10)


def test_share_influence_is_the_derivative_in_a_draw_s_weight():
    rng = np.random.default_rng(7)
    mean, sd = rng.normal(size=20), 0.3 * np.exp(0.3 * rng.normal(size=20))
    spread = np.exp(0.4 * rng.normal(size=20))
    _, _, influence = share_half_width(
        mean[:, None], sd[:, None], spread[:, None], share=0.9, confidence=0.95
    )

    def limits(weights):
        centre = np.array([weights @ mean])

        def held(h):
            return share_content(
                np.array([h]), centre, mean[:, None], sd[:, None], spread[:, None], 0.9
            )[0][:, 0]

        h = weighted_root(lambda h: held(h) - 0.95, weights, 0.5, 40.0)
        return np.array([centre[0] - h, centre[0] + h])

    assert_derivatives(influence, limits)
