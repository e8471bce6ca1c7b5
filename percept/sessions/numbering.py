"""Ids as numbers in order of first appearance, across blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd


class Registry:
    """Ids, or packed numbers, numbered in order of first appearance."""

    def __init__(self) -> None:
        self.names: list[Any] = []
        self._number: dict[Any, int] = {}

    def numbers(self, codes: npt.NDArray[np.integer[Any]], names: Sequence[Any]) -> npt.NDArray[np.int64]:
        """Return numbers of ids."""
        lookup = np.empty(len(names), dtype=np.int64)
        for at, name in enumerate(names):
            lookup[at] = self._number.setdefault(name, len(self.names))
            if lookup[at] == len(self.names):
                self.names.append(name)
        return lookup[codes]


def codes_of(column: pd.Series[Any]) -> tuple[npt.NDArray[np.integer[Any]], Sequence[Any]]:
    """Codes of a column into its ids in order of first appearance."""
    if isinstance(column.dtype, pd.CategoricalDtype):
        return column.cat.codes.to_numpy(), column.cat.categories.tolist()
    codes, names = pd.factorize(column)
    return codes, names.tolist()


def distinct(packed: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.integer[Any]], Sequence[int]]:
    """Codes of packed numbers, and the distinct ones in order of first appearance."""
    codes, names = pd.factorize(packed)
    return codes, names.tolist()


def grown(grid: npt.NDArray[np.bool_], shape: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Grid of at least `shape`, doubling, so that growing costs little in all."""
    if grid.shape[0] >= shape[0] and grid.shape[1] >= shape[1]:
        return grid
    rows, columns = (
        have if have >= want else max(want, 2 * have) for have, want in zip(grid.shape, shape, strict=True)
    )
    out = np.zeros((rows, columns), dtype=np.bool_)
    out[: grid.shape[0], : grid.shape[1]] = grid
    return out
