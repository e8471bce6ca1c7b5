"""Draws of a posterior and the data beside them, by group, as posterior.nc holds them."""

from __future__ import annotations

import dataclasses
from typing import Any

from numpy.typing import NDArray

__all__ = ["DrawGroup", "NamedArray"]


@dataclasses.dataclass(frozen=True, eq=False)
class NamedArray:
    """An array whose dimensions have names."""

    dimensions: tuple[str, ...]
    values: NDArray[Any]  # Numbers, or texts as objects
    attributes: dict[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class DrawGroup:
    """Variables that share dimensions and their labels."""

    variables: dict[str, NamedArray]
    coordinates: dict[str, NamedArray]  # Labels of dimensions, under the dimension's name or more
    attributes: dict[str, str]

    @property
    def sizes(self) -> dict[str, int]:
        """Length of each dimension, by name."""
        found: dict[str, int] = {}
        for array in self.variables.values():
            found |= dict(zip(array.dimensions, array.values.shape, strict=True))
        return found
