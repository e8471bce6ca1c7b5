"""Users of an environment nobody was tested in, by the regression over the environments tested."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments
from percept.inference.hierarchy.models import IntervalEstimands, Model, Product
from percept.inference.hierarchy.scales import Scales
from percept.inference.sampling.gate import Estimates

Array = NDArray[np.float64]
# Powers of the plastic number: their multiples fill the square evenly.
_STEPS = 1.32471795724474602596 ** np.array([-1.0, -2.0])
_LEAST = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class NewEnvironment:
    """What S posterior draws say of one new environment; P parameters, on the response scale."""

    mean: Array  # (S, P) Conditional mean of β*
    covariance: Array  # (S, P, P) Conditional covariance of β*
    population: Array  # (S, P, P) Σ_u + Σ_w*: covariance of users about β*

    @property
    def laws(self) -> ConditionalMoments:
        """Each parameter by itself, cells being parameters."""
        variances = (
            np.diagonal(part, axis1=1, axis2=2) for part in (self.covariance, self.population)
        )
        return ConditionalMoments(self.mean, *map(np.sqrt, variances))


def new_environment(
    model: Model, points: Array, x: Array, *, repeats: int, rng: np.random.Generator
) -> NewEnvironment:
    """Work out the laws of a new environment at posterior draws, with `repeats` spreads for each."""
    if isinstance(model, Product):
        parts = [
            new_environment(part, own, x[[p]], repeats=repeats, rng=rng)
            for p, (part, own) in enumerate(model.split(points))
        ]
        mean = np.concatenate([part.mean for part in parts], axis=1)
        variances = (
            np.concatenate([getattr(part, name)[:, 0] for part in parts], axis=1)
            for name in ("covariance", "population")
        )
        # Uncorrelated parameters.
        return NewEnvironment(mean, *(own[..., None] * np.eye(x.size) for own in variances))
    if not isinstance(model, CollapsedDensity):
        hint = 'Set pooling = "partial" in [model].'
        raise RefusalError("environments without pooling say nothing on others.", hint=hint)
    if not model.layout.trend:
        hint = "Add sessions with more reference environments."
        raise RefusalError("one environment says nothing on others.", hint=hint)

    def given(scales: Scales) -> tuple[Array, Array, Array]:
        return _given_scales(model, scales, x, repeats, rng)

    return NewEnvironment(*model.by_pass(points, given))


def _given_scales(
    density: CollapsedDensity, scales: Scales, x: Array, repeats: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Moments at W sets of scales: the location is normal given these, log sigma is drawn evenly."""
    count, width = x.size, scales.log_prior.size
    # On alpha and gamma over their prior SDs.
    rows = np.zeros((count, 2 * count))
    rows[:, :count] = density.priors.alpha_sd * np.eye(count)
    rows[:, count:] = density.priors.gamma_sd * np.diag(x)
    mean, spread = density.locations(scales).trend(rows)
    covariance = np.einsum("qpw,qrw->wpr", spread, spread)
    named = scales.named
    covariance[:, range(count), range(count)] += named["tau"].T ** 2
    log_sigma = np.log(named["s"]) + named.get("kappa", 0.0) * x[:, None]
    sigma = np.exp(
        log_sigma + named.get("omega", np.zeros((count, 1))) * _even((repeats, count, width), rng)
    )
    population = _covariance(np.moveaxis(sigma, -1, 0), named.get("rho_w"))
    if "sigma_u" in named:
        population = population + _covariance(named["sigma_u"].T[:, None], named.get("rho_u"))
    mean, covariance = (np.repeat(part, repeats, axis=0) for part in (mean.T, covariance))
    return mean, covariance, population.reshape(-1, count, count)


def _even(shape: tuple[int, int, int], rng: np.random.Generator) -> Array:
    """Return standard normals (R, P, W) that fill the square evenly, R in turn for each draw."""
    repeats, count, width = shape
    place = np.multiply.outer(np.arange(width * repeats), _STEPS[:count]) + rng.random(count)
    normals = special.ndtri(np.clip(place % 1.0, _LEAST, 1.0 - _LEAST))
    return np.moveaxis(normals.reshape(width, repeats, count), 0, -1)


def _covariance(sd: Array, rho: Array | None) -> Array:
    """Covariances (W, R, P, P) from SDs (W, R, P) and a correlation (W,)."""
    matrix = sd[..., :, None] * sd[..., None, :]
    if rho is not None:
        matrix[..., 0, 1] *= rho[:, None]
        matrix[..., 1, 0] *= rho[:, None]
    return matrix


class NewEstimands(IntervalEstimands):
    """Endpoints of the intervals of a new environment, cells being parameters."""

    def __init__(self, estimands: IntervalEstimands, x: Array, repeats: int, seed: int) -> None:
        vars(self).update(vars(estimands))
        self._x, self._repeats, self._seed = x, repeats, seed
        self._rng = np.random.default_rng(seed)
        self.cells = tuple(
            (parameter, "new") for parameter in dict.fromkeys(p for p, _ in estimands.cells)
        )

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        return (*super().identity(), "new", tuple(self._x.tolist()), self._repeats, self._seed)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, shape (W, 3 P R): every spread side by side."""
        found = new_environment(self.model, points, self._x, repeats=self._repeats, rng=self._rng)
        return found.laws.pack().reshape(len(points), -1)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits of each kind, and the influence of each draw over all its spreads."""
        for found, influence in super().estimates(
            components.reshape(len(components) * self._repeats, -1)
        ):
            yield found, influence.reshape(len(components), self._repeats, -1).mean(axis=1)
