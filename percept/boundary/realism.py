"""Probability that a displayed impedance feels real, from posterior draws of the population of users.

Each draw of the posterior is a population: limits of stiffness and of damping between which a level of all
users have their points of equality. What is displayed is realistic under that draw where it lies inside, in
magnitude (the exact range of abs(Z_h) over the limits) or, more strictly, in stiffness and damping both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.haptics import AnyDevice, magnitude_envelope
from percept.html import NotebookRecord

Array = NDArray[np.float64]
_BLOCK_VALUES = 1 << 18


@dataclass(frozen=True, eq=False)
class Populations:
    """Limits between which a level of the users of each of S posterior draws lie."""

    stiffness: tuple[Array, Array]  # (S,)
    damping: tuple[Array, Array]  # (S,)


@dataclass(frozen=True, eq=False)
class Displayed:
    """What the device shows at some frequencies."""

    omega: Array  # (M,) rad/s
    magnitude: Array  # (M,) abs(Z_h), N·s/m
    stiffness: Array  # (M,)
    damping: Array  # (M,)


@dataclass(frozen=True, eq=False)
class Realism(NotebookRecord):
    """Probability over posterior draws of being realistic."""

    omega: Array  # (M,) rad/s
    magnitude: Array  # (M,)
    plane: Array  # (M,)
    magnitude_throughout: float  # Probability of being realistic at every omega
    plane_throughout: float  # Probability of being realistic at every omega


def realism(
    displayed: Sequence[Displayed],
    populations: Populations,
    device: AnyDevice,
    period: float,
    *,
    hold: str = "average",
) -> list[Realism]:
    """Work out the probability of being realistic, at each omega and throughout."""
    draws = populations.stiffness[0].size
    if not draws:
        raise UsageError("probabilities need at least one posterior draw.")
    omega = displayed[0].omega
    if any(not np.array_equal(one.omega, omega) for one in displayed):
        raise UsageError("displays to be judged together need the same omega.")
    step = max(1, _BLOCK_VALUES // draws)
    probability = np.empty((len(displayed), 2, omega.size))
    always = np.ones((len(displayed), 2, draws), dtype=bool)
    for start in range(0, omega.size, step):
        part = slice(start, start + step)
        lower, upper = magnitude_envelope(
            omega[part, None], device, populations.stiffness, populations.damping, period, hold=hold
        )
        for d, one in enumerate(displayed):
            shown = one.magnitude[part, None]
            inside = (lower <= shown) & (shown <= upper)
            within = _between(one.stiffness[part], populations.stiffness)
            within &= _between(one.damping[part], populations.damping)
            for way, true in enumerate((inside, within)):
                probability[d, way, part] = true.mean(axis=1)
                always[d, way] &= true.all(axis=0)
    throughout = always.mean(axis=2).tolist()
    return [
        Realism(omega, *by_omega, *whole) for by_omega, whole in zip(probability, throughout, strict=True)
    ]


def _between(values: Array, limits: tuple[Array, Array]) -> NDArray[np.bool_]:
    return (limits[0] <= values[:, None]) & (values[:, None] <= limits[1])
