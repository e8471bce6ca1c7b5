"""Users of an environment nobody was tested in, by the regression over the environments tested."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity, ConditionalMoments
from percept.inference.hierarchy.models import IntervalEstimands, Model
from percept.inference.hierarchy.scales import Scales
from percept.inference.sampling.gate import Estimates

__all__ = ["NewEnvironment", "NewEstimands", "new_environment"]

Array = NDArray[np.float64]

#: Real root of x³ = x + 1: multiples of its powers fill the square evenly (Roberts 2018), which
#: `scipy.stats.qmc` does for numbers of points that are powers of two alone.
_PLASTIC = 1.32471795724474602596
_STEPS = _PLASTIC ** np.array([-1.0, -2.0])
#: Least probability whose normal score is taken: zero has none.
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
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)
        population_variance = np.diagonal(self.population, axis1=1, axis2=2)
        return ConditionalMoments(
            mean=self.mean,
            sd=np.sqrt(variance),
            population_sd=np.sqrt(population_variance),
        )


def new_environment(
    model: Model,
    points: Array,
    x: Array,
    *,
    repeats: int,
    rng: np.random.Generator,
) -> NewEnvironment:
    """Work out the laws of a new environment at posterior draws.

    Parameters
    ----------
    model : Model
        That pools environments.
    points : ndarray
        Coordinates of W draws, shape (W, d).
    x : ndarray
        Decades of the references above the geometric mean of those tested, shape (P,).
    repeats : int
        Spreads drawn for each draw: S = W · repeats.
    rng : Generator
        Where they come from.

    Returns
    -------
    NewEnvironment
        Parameters of different models are uncorrelated.

    Raises
    ------
    RefusalError
        A model without pooling, or of one environment.
    """
    parts = []
    first = 0
    for density, coordinates in model.pooled_parts(points):
        if not density.layout.trend:
            hint = "Add sessions with more reference environments."
            raise RefusalError("one environment shows no trend to predict others from.", hint=hint)
        last = first + density.layout.parameters
        parts.append(_of_density(density, coordinates, x[first:last], repeats, rng))
        first = last
    if not parts:
        hint = 'Set pooling = "partial" in [model].'
        raise RefusalError("without pooling, an environment tells nothing about others.", hint=hint)
    return NewEnvironment(
        mean=np.hstack([part.mean for part in parts]),
        covariance=linalg.block_diag(*(part.covariance for part in parts)),
        population=linalg.block_diag(*(part.population for part in parts)),
    )


def _of_density(
    density: CollapsedDensity,
    points: Array,
    x: Array,
    repeats: int,
    rng: np.random.Generator,
) -> NewEnvironment:
    def given(scales: Scales) -> tuple[Array, Array, Array]:
        mean, covariance = _location(density, scales, x)
        population = _population(scales, x, repeats, rng)
        return (
            np.repeat(mean, repeats, axis=0),
            np.repeat(covariance, repeats, axis=0),
            population.reshape(-1, x.size, x.size),
        )

    return NewEnvironment(*density.by_pass(points, given))


def _location(
    density: CollapsedDensity,
    scales: Scales,
    x: Array,
) -> tuple[Array, Array]:
    """Mean (W, P) and covariance (W, P, P) of the location at W sets of scales: it is normal."""
    count = x.size
    # On alpha and gamma over their prior SDs.
    rows = np.zeros((count, 2 * count))
    rows[:, :count] = density.priors.alpha_sd * np.eye(count)
    rows[:, count:] = density.priors.gamma_sd * np.diag(x)
    mean, spread = density.locations(scales).trend(rows)
    covariance = np.einsum("qpw,qrw->wpr", spread, spread)
    tau = scales.named["tau"].T
    covariance[:, range(count), range(count)] += tau**2
    return mean.T, covariance


def _population(
    scales: Scales,
    x: Array,
    repeats: int,
    rng: np.random.Generator,
) -> Array:
    """Covariances of users (W, R, P, P) at W sets of scales, log sigma drawn evenly."""
    count = x.size
    width = scales.log_prior.size
    named = scales.named
    kappa = named.get("kappa", 0.0)
    log_sigma = np.log(named["s"]) + kappa * x[:, None]
    omega = named.get("omega", np.zeros((count, 1)))
    normals = _even_normals(repeats, count, width, rng)
    sigma = np.exp(log_sigma + omega * normals)
    population = _covariance(np.moveaxis(sigma, -1, 0), named.get("rho_w"))
    if "sigma_u" not in named:
        return population
    sigma_u = named["sigma_u"].T[:, None]
    return population + _covariance(sigma_u, named.get("rho_u"))


def _even_normals(
    repeats: int,
    count: int,
    width: int,
    rng: np.random.Generator,
) -> Array:
    """Return standard normals (R, P, W) that fill the square evenly, R in turn for each draw."""
    points = np.arange(width * repeats)
    multiples = np.multiply.outer(points, _STEPS[:count])
    uniforms = (multiples + rng.random(count)) % 1.0
    normals = special.ndtri(np.clip(uniforms, _LEAST, 1.0 - _LEAST))
    return np.moveaxis(normals.reshape(width, repeats, count), 0, -1)


def _covariance(sd: Array, rho: Array | None) -> Array:
    """Covariances (W, R, P, P) from SDs (W, R, P) and a correlation (W,)."""
    matrix = sd[..., :, None] * sd[..., None, :]
    if rho is not None:
        matrix[..., 0, 1] *= rho[:, None]
        matrix[..., 1, 0] *= rho[:, None]
    return matrix


class NewEstimands(IntervalEstimands):
    """Limits of the intervals of a new environment, cells being parameters."""

    def __init__(
        self,
        estimands: IntervalEstimands,
        x: Array,
        repeats: int,
        seed: int,
    ) -> None:
        super().__init__(
            estimands.model,
            kinds=estimands.kinds,
            level=estimands.level,
            share=estimands.share,
            confidence=estimands.confidence,
        )
        self._x = x
        self._repeats = repeats
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        parameters = dict.fromkeys(parameter for parameter, _ in estimands.cells)
        self.cells = tuple((parameter, "new") for parameter in parameters)

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        decades = tuple(self._x.tolist())
        return (*super().identity(), "new", decades, self._repeats, self._seed)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, shape (W, 3 P R): every spread side by side."""
        new = new_environment(self.model, points, self._x, repeats=self._repeats, rng=self._rng)
        return new.laws.pack().reshape(len(points), -1)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits of each kind, and the influence of each draw over all its spreads."""
        draws = len(components)
        spreads = components.reshape(draws * self._repeats, -1)
        for estimates, influence in super().estimates(spreads):
            by_draw = influence.reshape(draws, self._repeats, -1)
            yield estimates, by_draw.mean(axis=1)
