"""Limits of abs(Z_h) from a law of (k, b), against many draws of the law and quantiles of their
curves."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from percept.boundary.law import PairLaw, confidence_law, mixture_law
from percept.boundary.limits import Magnitude
from percept.boundary.shares import score_of
from percept.errors import RefusalError
from percept.haptics import Device, Loop
from percept.haptics.perceived import perceived_magnitude
from tests import LONG
from tests.boundary.test_law import B, K, mixture

DEVICE, PERIOD = Device(1.0, 5.0), 1e-3
OMEGA = np.geomspace(0.1, 300.0, 61)
SCORE = score_of(0.99)
DRAWS = 400_000 if LONG else 40_000


def drawn_from(mean: np.ndarray, covariance: np.ndarray, seed: int) -> np.ndarray:
    """Draws of a mixture, one component each in turn, shape (2, DRAWS)."""
    rng, at = np.random.default_rng(seed), np.arange(DRAWS) % len(mean)
    root = np.linalg.cholesky(covariance)
    return (mean[at] + np.einsum("sij,sj->si", root[at], rng.standard_normal((DRAWS, 2)))).T


@cache
def laws() -> list[tuple[PairLaw, np.ndarray]]:
    mean, covariance = mixture()
    batch = np.arange(400) % 16
    found = [
        (mixture_law(mean, covariance, batch, "lognormal"), np.exp(drawn_from(mean, covariance, 1)))
    ]
    # Normal, so that k and b below zero belong to it; and k known far better than b.
    scale = np.array([1000.0, 2.0])
    mean, covariance = scale * (mean - [8.0, 1.0]), covariance * np.outer(scale, scale)
    found.append((mixture_law(mean, covariance, batch, "normal"), drawn_from(mean, covariance, 2)))
    rng = np.random.default_rng(3)
    centre, shape = np.log([K, B]).mean(axis=1), np.cov(np.log([K, B])) * 1.1
    t = (
        rng.multivariate_normal([0.0, 0.0], shape, DRAWS)
        / np.sqrt(rng.chisquare(9, DRAWS) / 9)[:, None]
    )
    found.append((confidence_law(K, B, kind="user", family="lognormal"), np.exp(centre + t).T))
    # Users so far apart in k, by some 40 powers of ten, that the grid reaches below the least
    # number.
    mean, covariance = mixture()
    covariance = covariance * np.outer([150.0, 2.0], [150.0, 2.0])
    found.append(
        (mixture_law(mean, covariance, batch, "lognormal"), np.exp(drawn_from(mean, covariance, 4)))
    )
    return found


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("which", [0, 1, 2, 3])
@pytest.mark.parametrize("device", [DEVICE, Device(0.0, 0.5), Device(20.0, 300.0)], ids=str)
def test_limits_leave_out_as_many_draws_as_they_say(which: int, device: Device) -> None:
    law, (k, b) = laws()[which]
    magnitude = Magnitude(law, Loop(device, PERIOD), OMEGA)
    limits = magnitude.limits(SCORE)
    # A law that is not drawn is not calibrated.
    is_drawn = law.shares.size > 0
    score, shifts = magnitude.simultaneous_score(0.99) if is_drawn else (SCORE, np.empty(0))
    wide = magnitude.limits(score)
    assert (wide.lower <= limits.lower).all()
    assert (limits.upper <= wide.upper).all()
    error, inside = np.sqrt(0.005 * 0.995 / DRAWS), np.ones(DRAWS, dtype=bool)
    for m, omega in enumerate(OMEGA):
        curve = perceived_magnitude(Loop(device, PERIOD), omega, k, b)
        assert abs((curve < limits.lower[m]).mean() - 0.005) < 4.5 * error + 1e-4
        assert abs((curve > limits.upper[m]).mean() - 0.005) < 4.5 * error + 1e-4
        inside &= (wide.lower[m] <= curve) & (curve <= wide.upper[m])
    if not is_drawn:
        return
    # The score's own error moves the share as it moves what lies beyond the score.
    share_of_level = 0.01 * law.standard_error(shifts) * norm.pdf(score) / norm.sf(score)
    share = np.hypot(np.sqrt(0.01 * 0.99 / DRAWS), share_of_level)
    assert abs(inside.mean() - 0.99) < 4.5 * share


def heavy_mixture(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """SDs of log b scatter: at 100 rad/s, where the mass hides b, an upper limit moves by many
    bands."""
    rng = np.random.default_rng(seed)
    mean = np.array([2.6, -1.6]) + np.array([0.1, 0.5]) * rng.standard_normal((count, 2))
    sd = np.array([0.22, 1.6]) * np.exp(0.1 * rng.standard_normal((count, 2)))
    return mean, sd[:, :, None] ** 2 * np.eye(2)


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("draw", [mixture, heavy_mixture])
def test_stated_error_is_the_scatter_between_sets_of_draws(draw: Callable[..., Any]) -> None:
    omega = np.array([1.0, 30.0, 100.0])
    found = []
    sets = 60 if LONG else 16
    # The SD of so many numbers scatters by this.
    spread = 1.0 / np.sqrt(2.0 * (sets - 1))
    for seed in range(sets):
        law = mixture_law(*draw(320, seed), np.arange(320) % 16, "lognormal")
        magnitude = Magnitude(law, Loop(DEVICE, PERIOD), omega)
        score, shifts = magnitude.simultaneous_score(0.99)
        of_score = score, law.standard_error(shifts)
        found.append((magnitude.limits(SCORE), magnitude.limits(score, shifts), of_score))
    for which in (0, 1):
        limits = [each[which] for each in found]
        scatter = np.log([(one.lower, one.upper) for one in limits]).std(axis=0, ddof=1)
        stated = np.sqrt(np.mean([np.square(one.errors) for one in limits], axis=0))
        # The errors, of 15 degrees of freedom each, scatter by far less.
        assert np.abs(np.log(stated / scatter)).max() < 4.0 * spread
    scores, errors = np.array([each[2] for each in found]).T
    stated_error = np.sqrt(np.mean(errors**2))
    # Batches of twenty draws bend: what they add is counted too.
    assert -4.0 * spread < np.log(stated_error / scores.std(ddof=1)) < np.log(2.5)


def test_limits_that_a_law_does_not_determine_are_refused() -> None:
    mean, covariance = mixture()
    far = mixture_law(mean, covariance * 4e4, np.arange(400) % 16, "lognormal")
    with pytest.raises(RefusalError, match=r"a limit may lie beyond 1e\+40 N·s/m"):
        Magnitude(far, Loop(DEVICE, PERIOD), OMEGA).limits(SCORE)
    law = mixture_law(mean, covariance, np.arange(400) % 16, "lognormal")
    with pytest.raises(RefusalError, match=r"determines limits up to the level 0\.99998 only"):
        Magnitude(law, Loop(DEVICE, PERIOD), OMEGA).limits(score_of(1.0 - 1e-6))


def test_the_mass_of_an_environment_moves_its_resonance() -> None:
    law = laws()[0][0]
    found, same = (
        Magnitude(law, Loop(device, PERIOD), OMEGA, mass=mass).limits(score_of(0.9))
        for device, mass in ((DEVICE, 0.5), (Device(1.5, 5.0), 0.0))
    )
    # Rigidly joined, half a kilogram is the device's or the environment's.
    slow = OMEGA < 30.0
    np.testing.assert_allclose(found.lower[slow], same.lower[slow], rtol=2e-2)
