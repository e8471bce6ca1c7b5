"""Users of an untested environment, by the regression over the environments tested."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.errors import RefusalError
from percept.inference.model.interval_estimands import IntervalEstimands
from percept.inference.model.laws import NewEnvironment
from percept.inference.model.model import Model
from percept.inference.model.product import pooled_parts
from percept.inference.sampling.gate import Estimates

__all__ = ["NewEstimands", "new_environment", "new_name"]

Array = NDArray[np.float64]


def new_environment(
    model: Model,
    points: Array,
    x: Array,
    *,
    repeats: int,
    rng: np.random.Generator,
) -> dict[str, NewEnvironment]:
    """Work out the laws of a new environment in each condition, at posterior draws.

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
    dict of str to NewEnvironment
        By the levels of all factors; without factors there is one, with an empty name. Parameters
        of different models are uncorrelated.

    Raises
    ------
    RefusalError
        A model without pooling, or of one environment.
    """
    parts = []
    first = 0
    for density, coordinates in pooled_parts(model, points):
        last = first + len(density.statistics.parameters)
        parts.append(density.new_environment(coordinates, x[first:last], repeats, rng))
        first = last
    if not parts:
        hint = 'Set pooling = "partial" in [model].'
        raise RefusalError("without pooling, an environment tells nothing about others.", hint=hint)
    conditions = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: _joined([part[name] for part in parts]) for name in conditions}


def _joined(parts: list[NewEnvironment]) -> NewEnvironment:
    """Put quantities of different models together, without correlation."""
    return NewEnvironment(
        mean=np.hstack([part.mean for part in parts]),
        covariance=linalg.block_diag(*(part.covariance for part in parts)),
        population=linalg.block_diag(*(part.population for part in parts)),
    )


def new_name(condition: str) -> str:
    """Name the new environment in a condition."""
    return f"new ({condition})" if condition else "new"


class NewEstimands(IntervalEstimands):
    """Limits of the intervals of a new environment, cells being parameters in its conditions."""

    def __init__(
        self,
        estimands: IntervalEstimands,
        x: Array,
        repeats: int,
        seed: int,
        names: Sequence[str],
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
        self._conditions = len(names)
        self.cells = tuple((parameter, name) for name in names for parameter in parameters)

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        decades = tuple(self._x.tolist())
        return (*super().identity(), "new", decades, self._repeats, self._seed)

    def components(self, points: Array) -> Array:
        """ConditionalMoments per draw, shape (W, 3 L P R): every spread side by side."""
        new = new_environment(self.model, points, self._x, repeats=self._repeats, rng=self._rng)
        packed = [of_condition.laws.pack() for of_condition in new.values()]
        return np.hstack(packed).reshape(len(points), -1)

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits of each kind, and the influence of each draw over all its spreads."""
        draws = len(components)
        by_condition = components.reshape(draws * self._repeats, self._conditions, 3, -1)
        spreads = by_condition.swapaxes(1, 2).reshape(draws * self._repeats, -1)
        for estimates, influence in super().estimates(spreads):
            by_draw = influence.reshape(draws, self._repeats, -1)
            yield estimates, by_draw.mean(axis=1)
