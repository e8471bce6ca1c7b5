"""The locations beta given the scales: exactly Gaussian, as moments or as draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Pair, Scalar, Vector
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.laws import Laws
from percept.inference.hierarchy.least_squares import factor
from percept.inference.hierarchy.locations import stack_columns
from percept.inference.hierarchy.scales import Scales

Array = NDArray[np.float64]


class Conditional:
    """Law of beta given W sets of scales and the data."""

    def __init__(self, density: CollapsedDensity, scales: Scales) -> None:
        problem = density.regression.build(scales, density.cell_blocks(scales), merge=False)
        self._solved = factor(problem.design, problem.target)
        parameters = len(density.statistics.parameters)
        shape = (len(density.statistics.environments), scales.log_prior.size)
        self._own: Block | None = None
        # Columns of beta on the latents, (q, J, W) per parameter, and what does not depend on them.
        on_latents = list(stack_columns(problem.locations, shape))
        constant = [np.zeros(shape) for _ in range(parameters)]
        extra = len(problem.columns) - len(problem.locations)
        if extra:
            on_latents = [np.concatenate([rows, np.zeros((extra, *shape))]) for rows in on_latents]
        if problem.pooled is not None and scales.tau is not None:
            variances = tuple(tau * tau for tau in scales.tau)
            pull = problem.pooled.spread.plus_diagonal(variances).inverse()
            for q, column in enumerate(problem.columns):
                change = pull.apply(tuple(np.broadcast_to(c, shape) for c in column))
                for p in range(parameters):
                    on_latents[p][q] -= variances[p] * change[p]
            pulled = pull.apply(problem.pooled.mean)
            constant = [variances[p] * pulled[p] for p in range(parameters)]
            inverse = tuple(np.broadcast_to(1.0 / variance, shape) for variance in variances)
            self._own = problem.pooled.spread.inverse().plus_diagonal(inverse).inverse()
        self._on_latents, self._constant = on_latents, constant
        latents = self._solved.mean
        self.mean: Vector = tuple(
            c + np.einsum("qjw,qw->jw", rows, latents) for c, rows in zip(constant, on_latents, strict=True)
        )
        self._spread = [self._solved.solve_transposed(rows) for rows in on_latents]
        own = self._own
        self.covariance = _gram(self._spread) if own is None else _gram(self._spread) + own
        self.population = scales.between
        if scales.shared is not None:
            self.population = _broadcast(scales.shared, shape) + scales.between

    @property
    def laws(self) -> Laws:
        """Laws of beta and of the population, cells parameter by parameter."""
        sd = np.sqrt(np.concatenate(self.covariance.diagonal()))
        spread = np.sqrt(np.concatenate(self.population.diagonal()))
        return Laws(np.concatenate(self.mean).T, sd.T, spread.T)

    def joint_columns(self) -> Array:
        """Columns whose outer products sum to the covariance of beta over all cells: shape (R, P, J, W)."""
        columns = np.stack(self._spread, axis=1)
        if self._own is None:
            return columns
        own = self._own.factor_columns()
        _, size, environments, width = columns.shape
        apart = np.zeros((len(own), environments, size, environments, width))
        at = np.arange(environments)
        for c, column in enumerate(own):
            for p, part in enumerate(column):
                apart[c, at, p, at] = part
        return np.concatenate([columns, apart.reshape(-1, size, environments, width)])

    def draw(self, rng: np.random.Generator) -> Array:
        """Draw beta of all environments jointly, once per set of scales."""
        size, width = self._solved.coefficients.shape
        latents = self._solved.solve(self._solved.coefficients + rng.standard_normal((size, width)))
        beta = np.stack(
            [
                c + np.einsum("qjw,qw->jw", rows, latents)
                for c, rows in zip(self._constant, self._on_latents, strict=True)
            ]
        )
        if self._own is not None:
            for column in self._own.factor_columns():
                beta += np.stack(column) * rng.standard_normal(beta.shape[1:])
        return beta


def _gram(spread: list[Array]) -> Block:
    """C'C for columns of shape (q, J, W), as a block: residual sums keep a near-singular one exact."""
    first = np.einsum("qjw,qjw->jw", spread[0], spread[0])
    if len(spread) == 1:
        return Scalar(first)
    cross = np.einsum("qjw,qjw->jw", spread[0], spread[1])
    # A variance that underflows leaves nothing to regress on.
    slope = np.divide(cross, first, out=np.zeros_like(cross), where=first > 0)
    left = spread[1] - slope * spread[0]
    return Pair(first, slope, np.einsum("qjw,qjw->jw", left, left))


def _broadcast(part: Block, shape: tuple[int, int]) -> Block:
    if isinstance(part, Scalar):
        return Scalar(np.broadcast_to(part.v, shape))
    return Pair(*(np.broadcast_to(getattr(part, name), shape) for name in ("v", "g", "w")))
