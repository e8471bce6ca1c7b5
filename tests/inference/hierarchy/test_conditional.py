import numpy as np
import pytest

from percept.inference.hierarchy.density import CollapsedDensity
from tests.inference.hierarchy import dense_twin, designs


def dense_conditional(study, scales, w):
    """Mean and covariance of beta (environment-major, parameter inner) by dense conditioning."""
    size, environments = study.x.shape
    # beta_j is what an extra, noise-free "trial" of a subject without effects would be.
    total = dense_twin.trial_covariance(
        study.subject, study.environment, study.x, scales, w, alpha_sd=1.0, gamma_sd=0.25
    )
    named = {key: value[..., w] for key, value in scales.named.items()}
    prior = np.zeros((environments, size, environments, size))
    for p in range(size):
        prior[:, p, :, p] += 1.0
        if "tau" in named:
            prior[:, p, :, p] += 0.25**2 * np.outer(study.x[p], study.x[p])
            prior[:, p, :, p] += np.eye(environments) * named["tau"][p] ** 2
    cross = prior[:, :, study.environment].reshape(environments * size, -1)
    prior = prior.reshape(environments * size, -1)
    gain = np.linalg.solve(total, cross.T).T
    return gain @ study.response.ravel(), prior - gain @ cross.T


@pytest.mark.parametrize("name", designs.NAMES)
def test_moments_equal_dense_conditioning(name):
    rng = np.random.default_rng(11)
    study = designs.study(name, rng)
    density = CollapsedDensity(study.statistics)
    scales = density.layout.scales(rng.normal(size=(density.dimension, 6)))
    conditional = density.locations(scales)
    size = study.x.shape[0]
    for w in range(6):
        mean, covariance = dense_conditional(study, scales, w)
        ours = np.stack([component[:, w] for component in conditional.mean], axis=1).ravel()
        np.testing.assert_allclose(ours, mean, rtol=1e-9, atol=1e-12)
        for j in range(study.x.shape[1]):
            dense = covariance[j * size : (j + 1) * size, j * size : (j + 1) * size]
            variances = [v[j, w] for v in conditional.covariance.diagonal()]
            np.testing.assert_allclose(variances, np.diag(dense), rtol=1e-8)
            if size == 2:
                block = conditional.covariance
                np.testing.assert_allclose(
                    block.slope[j, w] * block.variances[0][j, w], dense[0, 1], rtol=1e-7, atol=1e-13
                )


@pytest.mark.parametrize("name", ["balanced", "many patterns", "one environment"])
def test_draws_have_the_conditional_moments(name):
    rng = np.random.default_rng(5)
    study = designs.study(name, rng)
    density = CollapsedDensity(study.statistics)
    draws = 40_000
    coords = np.repeat(0.5 * rng.normal(size=(density.dimension, 1)), draws, axis=1)
    conditional = density.locations(density.layout.scales(coords))
    beta = conditional.draw(rng)
    flat = beta.transpose(1, 0, 2).reshape(-1, draws)
    mean, covariance = dense_conditional(study, density.layout.scales(coords[:, :1]), 0)
    error = np.sqrt(np.diag(covariance) / draws)
    assert np.all(np.abs(flat.mean(axis=1) - mean) < 4.5 * error)
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    z = (flat - mean[:, None]) / sd[:, None]
    products = np.einsum("an,bn->ab", z, z) / draws
    assert np.all(np.abs(products - correlation) < 4.5 * np.sqrt((1 + correlation**2) / draws))
