"""Digits the collapsed density keeps, beside those of the formulas it stands for in plain doubles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.bench import _density_reference as reference
from percept.bench._density_reference import Levels
from percept.inference.hierarchy.blocks import Block, block
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.scales import Scales
from percept.inference.hierarchy.statistics import from_trials

PROMISE = 1e-9
"""Largest error promised, per unit of 1 + abs(log p)."""

_ENVIRONMENTS, _TRIALS, _SUBJECTS = 3, 2, 10
_DENSE = 100  # subjects beyond which one covariance over all values would not fit
_PLAIN = Levels(between=0.2, shared=0.1, trial=0.05, tau=0.1, rest=0.5)
_EXPONENTS = (-12, -8, -4, 0, 4, 8, 12)

Array: TypeAlias = NDArray[np.float64]
Formula: TypeAlias = Callable[[Array, Array, Levels], float]


@dataclass(frozen=True)
class DensityDigits:
    """The worst case at one point of one sweep."""

    sweep: str
    value: float  # Its value
    ours: float
    dense: float | None
    woodbury: float
    worst: float  # percept's error over what is promised


@dataclass(frozen=True)
class _Case:
    sweep: str
    value: float
    levels: Levels = _PLAIN
    subjects: int = _SUBJECTS
    offset: float = 0.0


def density_digits(
    draws: int = 3, *, seed: int = 1, sweeps: tuple[str, ...] = (), formula: Formula | None = None
) -> list[DensityDigits]:
    """Compare log densities with 120-digit arithmetic. Needs mpmath."""
    rng = np.random.default_rng(seed)
    chosen = [case for case in _cases() if case.sweep in (sweeps or (case.sweep,))]
    return [_measure(case, formula or collapsed, draws, rng) for case in chosen]


def collapsed(response: Array, x: Array, levels: Levels) -> float:
    """Evaluate the log density by percept."""
    subjects, environments, trials, size = response.shape
    subject, environment, _ = (axis.ravel() for axis in np.indices((subjects, environments, trials)))
    statistics = from_trials(
        response.reshape(-1, size),
        subject,
        environment,
        x,
        parameters=("k", "b"),
        environments=tuple(f"VE{j + 1}" for j in range(environments)),
        subjects=tuple(f"S{i + 1}" for i in range(subjects)),
    )

    def level(sd: float, *shape: int) -> Block:
        rest = np.full(shape, levels.rest)
        return block((np.full(shape, sd), np.full(shape, sd)), 1.0 - rest, rest)

    scales = Scales(
        between=level(levels.between, environments, 1),
        shared=level(levels.shared, 1),
        trial=level(levels.trial, environments, 1),
        tau=(np.array([levels.tau]),) * 2,
        named={},
        log_prior=np.zeros(1),
    )
    return float(CollapsedDensity(statistics).log_likelihood(scales)[0])


def _cases() -> Iterator[_Case]:
    for exponent in _EXPONENTS:
        sd = 10.0 ** (exponent / 2)
        yield _Case("all variances", sd**2, Levels(sd, sd, sd, sd, 0.5))
    for name in ("between", "shared", "trial", "tau"):
        for exponent in _EXPONENTS:
            sd = 10.0 ** (exponent / 2)
            only: dict[str, Any] = {name: sd}
            yield _Case(
                f"variance of {name}, others 1e-12",
                sd**2,
                replace(Levels(1e-6, 1e-6, 1e-6, 1e-6, 0.5), **only),
            )
    for power in range(1, 10):
        yield _Case("1 - correlation", 10.0**-power, replace(_PLAIN, rest=10.0**-power))
    for subjects in (2, 10, 100, 1000, 10_000):
        yield _Case("subjects", subjects, subjects=subjects)
    for offset in (0.0, 1.0, 1e3, 1e6, 1e9):
        yield _Case("offset", offset, offset=offset)


def _measure(case: _Case, formula: Formula, draws: int, rng: np.random.Generator) -> DensityDigits:
    x = np.tile(np.linspace(-1.5, 1.5, _ENVIRONMENTS), (2, 1))
    worst = {"ours": 0.0, "dense": 0.0, "woodbury": 0.0}
    for _ in range(draws):
        response = case.offset + 0.3 * rng.standard_normal((case.subjects, _ENVIRONMENTS, _TRIALS, 2))
        exact = reference.exact(response, x, case.levels)
        found = {"ours": formula, "woodbury": reference.woodbury}
        if case.subjects <= _DENSE:
            found["dense"] = reference.dense
        for name, evaluate in found.items():
            worst[name] = max(worst[name], _error(evaluate(response, x, case.levels), exact))
    return DensityDigits(
        sweep=case.sweep,
        value=case.value,
        ours=_digits(worst["ours"]),
        dense=_digits(worst["dense"]) if case.subjects <= _DENSE else None,
        woodbury=_digits(worst["woodbury"]),
        worst=worst["ours"] / PROMISE,
    )


def _error(computed: float, exact: reference.Number) -> float:
    """Error over 1 + abs(log p); infinite for NaN."""
    if not math.isfinite(computed):
        return math.inf
    return float(abs(computed - exact) / (1 + abs(exact)))


def _digits(error: float) -> float:
    return min(16.0, max(0.0, -math.log10(max(error, 1e-300))))
