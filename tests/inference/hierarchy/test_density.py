import numpy as np
import pytest

from percept.inference.hierarchy.density import CollapsedDensity
from tests.inference.hierarchy import dense_twin, designs


@pytest.mark.parametrize("name", designs.NAMES)
def test_likelihood_equals_dense_multivariate_normal(name):
    rng = np.random.default_rng(7)
    study = designs.study(name, rng)
    density = CollapsedDensity(study.statistics)
    scales = density.layout.scales(rng.normal(size=(density.dimension, 12)))
    ours = density.log_likelihood(scales)
    twin = [
        dense_twin.log_likelihood(
            study.response, study.subject, study.environment, study.x, scales, w
        )
        for w in range(12)
    ]
    assert np.all(np.abs(ours - twin) <= 1e-9 * (1 + np.abs(twin)))
