"""Laws that a model gives of cells, of pairs of quantities and of new environments, per draw."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.model.blocks import Block
from percept.inference.model.priors import Named
from percept.inference.model.subject_covariance import SubjectCovariance

__all__ = [
    "ConditionalMoments",
    "NewEnvironment",
    "PairLaws",
    "PriorDraws",
    "SubjectLaws",
    "TrendLaw",
    "covariances",
    "even_normals",
    "joined",
]

Array = NDArray[np.float64]

#: Real root of x³ = x + 1: multiples of its powers fill the square evenly (Roberts 2018), which
#: `scipy.stats.qmc` does for numbers of points that are powers of two alone.
_PLASTIC = 1.32471795724474602596
_STEPS = _PLASTIC ** np.array([-1.0, -2.0])
#: Least probability whose normal score is taken: zero has none.
_LEAST = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class ConditionalMoments:
    """Law of each cell's location and of its users, given each draw, on the response scale.

    A cell is a parameter in an environment. Both laws are normal.
    """

    mean: Array  # (S, C) Mean of the location, and of the users
    sd: Array  # (S, C) SD of the location
    population_sd: Array  # (S, C) SD of users about the location

    def pack(self) -> Array:
        """Return all three side by side, shape (S, 3 C)."""
        return np.hstack([self.mean, self.sd, self.population_sd])

    def of(self, numbers: slice | list[int]) -> ConditionalMoments:
        """Laws of some of the cells."""
        return ConditionalMoments(
            self.mean[:, numbers], self.sd[:, numbers], self.population_sd[:, numbers]
        )

    @classmethod
    def unpack(cls, packed: Array) -> ConditionalMoments:
        """Undo `pack`."""
        return cls(*np.split(packed, 3, axis=1))

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw each cell's location and a new user of it, independently of other cells."""
        mean = self.mean + self.sd * rng.standard_normal(self.mean.shape)
        users = mean + self.population_sd * rng.standard_normal(mean.shape)
        return mean, users


@dataclasses.dataclass(frozen=True, eq=False)
class PairLaws:
    """Joint law of two parameters in each environment, given each draw."""

    mean: Array  # (S, J, 2) Mean of the locations
    location: Array  # (S, J, 2, 2) Covariance of the locations
    users: Array  # (S, J, 2, 2) Covariance of users about them


@dataclasses.dataclass(frozen=True, eq=False)
class TrendLaw:
    """Law of the line that the locations scatter about, given each draw: it is normal.

    A line has an intercept, at the geometric mean of the references, and a slope per decade.
    """

    mean: Array  # (S, P, 2) Of intercept and slope
    covariance: Array  # (S, P, 2, 2)


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectLaws:
    """What W sets of scales say of subjects' cell means: P quantities in C cells."""

    mean: Array  # (P, C, W) Mean of the locations
    columns: Array  # (R, P, C, W) Columns whose products sum to the locations' covariance
    effects: Array  # (q, P, C, W) What a unit of each of a subject's effects adds
    noise: tuple[Block, ...]  # (E, W) By pattern: the rest of the variance of cell means
    covariances: tuple[SubjectCovariance, ...]  # By pattern: of the cell means about the locations
    trial: Block | None  # Covariance between trials, one for each group of trials


@dataclasses.dataclass(frozen=True, eq=False)
class PriorDraws:
    """Draws of scales, population means and new users before any data."""

    scales: Named
    means: Array  # (draws, C)
    users: Array  # (draws, C)


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


#: Laws whose fields are arrays, draws first.
_Laws = TypeVar("_Laws", ConditionalMoments, PairLaws, TrendLaw, NewEnvironment)


def joined(laws: Sequence[_Laws]) -> _Laws:
    """Laws of some draws after another, as one."""
    fields = {}
    for field in dataclasses.fields(laws[0]):
        fields[field.name] = np.concatenate([getattr(law, field.name) for law in laws])
    return dataclasses.replace(laws[0], **fields)


def even_normals(
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


def covariances(sd: Array, rho: Array | None) -> Array:
    """Covariances (W, R, P, P) from SDs (W, R, P) and a correlation (W,)."""
    matrix = sd[..., :, None] * sd[..., None, :]
    if rho is not None:
        matrix[..., 0, 1] *= rho[:, None]
        matrix[..., 1, 0] *= rho[:, None]
    return matrix
