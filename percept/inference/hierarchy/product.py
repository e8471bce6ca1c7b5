"""Independent models sampled together, such as stiffness and damping from published limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.laws import Laws, Model

Array = NDArray[np.float64]


class Product:
    """Product of models, one per parameter."""

    def __init__(self, models: Sequence[Model]) -> None:
        self.models = tuple(models)
        self._ends = np.cumsum([len(model.names) for model in models])[:-1]
        self.cells = tuple(cell for model in models for cell in model.cells)

    def split(self, points: Array) -> list[Array]:
        """Coordinates (W, d) of each model, views."""
        return np.split(points, self._ends, axis=1)

    @property
    def names(self) -> list[str]:
        """Names of the coordinates."""
        return [name for model in self.models for name in model.names]

    @property
    def priors(self) -> dict[str, float]:
        """Priors in force in any of the models, by name."""
        return {name: value for model in self.models for name, value in model.priors.items()}

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        parts = [model(part) for model, part in zip(self.models, self.split(points), strict=True)]
        return np.sum(parts, axis=0)

    def laws(self, points: Array) -> Laws:
        """Laws of all cells at coordinates (W, d)."""
        parts = [model.laws(part) for model, part in zip(self.models, self.split(points), strict=True)]
        return Laws(
            *(np.concatenate([getattr(p, n) for p in parts], axis=1) for n in ("mean", "sd", "spread"))
        )

    def draw(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw population means and new users of all cells, each (W, C)."""
        parts = [model.draw(part, rng) for model, part in zip(self.models, self.split(points), strict=True)]
        means, users = zip(*parts, strict=True)
        return np.concatenate(means, axis=1), np.concatenate(users, axis=1)

    def scales(self, points: Array) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Named scales of all models, those along parameters put together."""
        parts = [model.scales(part) for model, part in zip(self.models, self.split(points), strict=True)]
        return {
            name: (dimensions, np.concatenate([part[name][1] for part in parts], axis=1))
            for name, (dimensions, _) in parts[0].items()
        }
