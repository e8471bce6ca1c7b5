"""Where ensembles start."""

import numpy as np
import pytest

from percept.errors import RefusalError
from percept.inference.sampling import warmup
from percept.inference.sampling.moves import Transported
from percept.inference.sampling.warmup import Affine, find_mode
from tests.inference.sampling.targets import Normal


class Apart(Normal):
    """Normals of mean 1 and SD 0.8."""

    def __call__(self, points):
        return super().__call__((points - 1.0) / 0.8)


def test_starting_points_are_draws_of_the_target_and_not_of_what_proposed_them():
    here = Transported(Apart(2), Affine(np.zeros(2), np.eye(2)))
    points = warmup.starting_points(here, np.random.default_rng(1), (4, 256)).reshape(-1, 2)
    # 1024 draws of 2048 by weights, some five hundred of them effective: 0.8/sqrt(500) = 0.036,
    # four times.
    np.testing.assert_allclose(points.mean(axis=0), 1.0, atol=0.15)
    np.testing.assert_allclose(points.std(axis=0), 0.8, atol=0.15)


def test_the_mode_of_a_correlated_normal_takes_its_full_curvature_once():
    rng = np.random.default_rng(5)
    size = 30
    turn, _ = np.linalg.qr(rng.normal(size=(size, size)))
    covariance = turn * np.geomspace(0.01, 3.0, size) @ turn.T
    precision = np.linalg.inv(covariance)
    centre = rng.normal(size=size)
    counts = []

    def density(points):
        counts.append(len(points))
        return -0.5 * np.einsum("wi,ij,wj->w", points - centre, precision, points - centre)

    mode, found = find_mode(density, np.zeros(size))
    # The search ends where a step gains less than 0.001: all steps left gain some times as much.
    distance = (mode - centre) @ precision @ (mode - centre)
    assert distance < 0.02
    np.testing.assert_allclose(found, covariance, rtol=1e-6, atol=1e-6)
    # Two density values for each pair, and two for each coordinate.
    full = size * (size - 1) + 2 * size + 1
    assert [count for count in counts if count > 2 * size + 1] == [full]


def test_the_mode_of_a_ridge_is_found_where_the_curvature_at_the_start_is_zero():
    def density(points):
        return np.minimum(points[:, 0], 8.0 - points[:, 0])

    mode, covariance = find_mode(density, np.zeros(1))
    np.testing.assert_allclose(mode, [4.0], rtol=1e-12)
    # The slope falls by 2 over a difference of 0.01.
    np.testing.assert_allclose(covariance, [[0.01 / 2.0]], rtol=1e-6)


@pytest.mark.parametrize(
    ("possible", "where"), [(0, "2048 of 2048 points,"), (1, "2047 of 2048 points,")]
)
def test_a_density_that_nearly_no_draw_finds_possible_is_refused(possible, where):
    class Hidden(Normal):
        """Possible at the mode, and at so many of the draws from the reference law."""

        def __call__(self, points):
            values = super().__call__(points)
            if len(points) >= 2048:
                values[possible:] = -np.inf
            return values

    with pytest.raises(RefusalError, match=f"-inf at {where} .* Check the data and the priors"):
        warmup.warm_up(Hidden(2), (4, 64), np.random.SeedSequence(1))
