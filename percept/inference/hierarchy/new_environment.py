"""The hierarchical model at an environment nobody tested: its bias and spread from the regressions.

For a new environment with x* decades the location is β* = α + γ x* + δ*, δ* ~ N(0, τ²), and the spread
log σ* ~ N(log s + κ x*, ω²). Given the scales, α + γ x* and δ* are Gaussian, so β* is known exactly; log σ*
is drawn, evenly over its law.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments
from percept.inference.hierarchy.models import Model, Pooled, Product

Array = NDArray[np.float64]
_CHUNK = 512


@dataclasses.dataclass(frozen=True, eq=False)
class NewEnvironment:
    """What S posterior draws say of one new environment; P parameters, on the response scale."""

    mean: Array  # (S, P) Conditional mean of β*
    covariance: Array  # (S, P, P) Conditional covariance of β*
    population: Array  # (S, P, P) Σ_u + Σ_w*: covariance of users about β*

    @property
    def laws(self) -> ConditionalMoments:
        """Each parameter by itself, cells being parameters."""
        sd, spread = (
            np.sqrt(np.diagonal(part, axis1=1, axis2=2)) for part in (self.covariance, self.population)
        )
        return ConditionalMoments(self.mean, sd, spread)

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the average and a next user once per posterior draw, each (S, P)."""
        average = self.mean + _correlated(self.covariance, rng)
        return average, average + _correlated(self.population, rng)


def new_environment(
    model: Model, points: Array, x: Array, *, repeats: int, rng: np.random.Generator
) -> NewEnvironment:
    """Work out the laws of a new environment at posterior draws."""
    if isinstance(model, Product):
        parts = [
            new_environment(part, own, x[[p]], repeats=repeats, rng=rng)
            for p, (part, own) in enumerate(zip(model.models, model.split(points), strict=True))
        ]
        return NewEnvironment(
            np.concatenate([part.mean for part in parts], axis=1),
            _side_by_side([part.covariance for part in parts]),
            _side_by_side([part.population for part in parts]),
        )
    if not isinstance(model, Pooled):
        raise RefusalError(
            "environments without pooling say nothing on others.",
            hint='Set pooling = "partial" in [model].',
        )
    density = model.density
    if not density.layout.trend:
        raise RefusalError(
            "one environment says nothing on others.", hint="Add sessions with more reference environments."
        )
    chunks = [_chunk(density, points[i : i + _CHUNK], x, repeats, rng) for i in range(0, len(points), _CHUNK)]
    return NewEnvironment(*(np.concatenate(chunk) for chunk in zip(*chunks, strict=True)))


def _side_by_side(variances: list[Array]) -> Array:
    """Covariances (S, P, P) of uncorrelated parameters from one variance (S, 1, 1) each."""
    joined = np.zeros((len(variances[0]), len(variances), len(variances)))
    for p, variance in enumerate(variances):
        joined[:, p, p] = variance[:, 0, 0]
    return joined


def _chunk(
    density: CollapsedDensity, points: Array, x: Array, repeats: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    scales = density.layout.scales(np.ascontiguousarray(points.T))
    count, width = x.size, len(points)
    # On alpha and gamma over their prior SDs.
    rows = np.zeros((count, 2 * count))
    rows[:, :count] = density.priors.alpha_sd * np.eye(count)
    rows[:, count:] = density.priors.gamma_sd * np.diag(x)
    mean, spread = density.locations(scales).trend(rows)
    mean = mean.T
    covariance = np.einsum("qpw,qrw->wpr", spread, spread)
    named = scales.named
    covariance[:, range(count), range(count)] += named["tau"].T ** 2
    log_sigma = np.log(named["s"]) + named.get("kappa", 0.0) * x[:, None]
    sigma = np.exp(log_sigma + named.get("omega", np.zeros((count, 1))) * _even((repeats, count, width), rng))
    population = _covariance(np.moveaxis(sigma, -1, 0), named.get("rho_w"))
    if "sigma_u" in named:
        population = population + _covariance(named["sigma_u"].T[:, None], named.get("rho_u"))
    return (
        np.repeat(mean, repeats, axis=0),
        np.repeat(covariance, repeats, axis=0),
        population.reshape(-1, count, count),
    )


def _even(shape: tuple[int, int, int], rng: np.random.Generator) -> Array:
    """Draw standard normals, along the first axis one from each of equally likely ranges."""
    ranges = rng.permuted(np.broadcast_to(np.arange(shape[0])[:, None, None], shape), axis=0)
    return special.ndtri((ranges + rng.uniform(1e-12, 1.0, shape)) / shape[0])


def _covariance(sd: Array, rho: Array | None) -> Array:
    """Covariances (W, R, P, P) from SDs (W, R, P) and a correlation (W,)."""
    matrix = sd[..., :, None] * sd[..., None, :]
    if rho is not None:
        matrix[..., 0, 1] *= rho[:, None]
        matrix[..., 1, 0] *= rho[:, None]
    return matrix


def _correlated(covariance: Array, rng: np.random.Generator) -> Array:
    """Draw from N(0, covariance), each (P, P) once; singular ones too."""
    z = rng.standard_normal(covariance.shape[:2])
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    if sd.shape[1] == 1:
        return sd * z
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = np.clip(np.nan_to_num(covariance[:, 0, 1] / (sd[:, 0] * sd[:, 1])), -1.0, 1.0)
    second = rho * z[:, 0] + np.sqrt((1.0 - rho) * (1.0 + rho)) * z[:, 1]
    return sd * np.stack([z[:, 0], second], axis=1)
