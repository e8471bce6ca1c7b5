"""Where ensembles start."""

import numpy as np

from percept.inference.sampling import warmup
from percept.inference.sampling.coordinates import Affine, Transported
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
