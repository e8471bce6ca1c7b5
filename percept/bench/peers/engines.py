"""The engines compared, and what each is asked to do."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from typing import Protocol

from percept.bench.peers.endpoints import Limits
from percept.bench.peers.responses import Responses
from percept.errors import UsageError


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """One run of an engine."""

    limits: dict[str, Limits]  # By how they were worked out: "mixture" of conditionals, "draws"
    seconds: float  # Wall time of sampling and of the limits, without compiling
    notes: dict[str, float]  # What its user would look at: divergences, acceptance, autocorrelation time


class Sampler(Protocol):
    """An engine made ready for one study."""

    def __call__(self, budget: float, seed: int) -> Fitted:
        """Sample within a budget, in the engine's own unit."""


@dataclasses.dataclass(frozen=True)
class Budget:
    """Amount of work asked, in the engine's own unit, and how often it is repeated."""

    size: float
    repeats: int


@dataclasses.dataclass(frozen=True)
class Engine:
    """One way to sample the model."""

    name: str
    title: str
    module: str  # Module of this package with `prepare(study, source) -> Sampler`
    packages: tuple[str, ...]  # Distributions whose versions are reported
    unit: str  # What a budget counts
    budgets: tuple[Budget, ...]  # Of a full run, smallest first
    quick: tuple[float, ...]  # Sizes that are enough to see that it works
    options: tuple[tuple[str, str], ...] = ()  # Keyword arguments of `prepare`

    def prepare(self, study: Responses, source: str) -> Sampler:
        """Import what the engine needs and build its model."""
        module = importlib.import_module(f"percept.bench.peers.{self.module}")
        make: Callable[..., Sampler] = module.prepare
        return make(study, source, **dict(self.options))


def _budgets(*pairs: tuple[float, int]) -> tuple[Budget, ...]:
    return tuple(Budget(*pair) for pair in pairs)


_NUTS_UNIT = "draws per chain, 4 chains"
_NUTS_SIZES = _budgets((250, 5), (1000, 5), (4000, 3), (16000, 1))
_WALKER_SIZES = _budgets((1000, 5), (4000, 5), (16000, 3), (64000, 1))
_NUTPIE_SIZES = _budgets((250, 5), (1000, 15), (4000, 3), (16000, 1))
_NUTPIE = ("nutpie", "pymc", "pytensor", "numba")
ENGINES = (
    Engine(
        "percept", "percept", "with_percept", ("percept", "emcee", "numpy", "scipy"), "tolerance",
        _budgets((0.1, 5), (0.02, 5), (0.01, 5), (0.005, 5), (0.002, 3), (0.001, 2)), (0.1,),
    ),
    Engine(
        "percept-stretch", "percept's density, emcee's stretch moves", "with_stretch", ("percept", "emcee"),
        "steps of 256 walkers", _WALKER_SIZES, (200,),
    ),
    Engine(
        "emcee", "emcee, nothing integrated out", "with_emcee", ("emcee", "numpy"), "steps of 256 walkers",
        _WALKER_SIZES, (200,),
    ),
    Engine(
        "nutpie", "nutpie, written plainly", "with_pymc", _NUTPIE, _NUTS_UNIT,
        _NUTPIE_SIZES, (50,), (("sampler", "nutpie"), ("form", "centred")),
    ),
    Engine(
        "nutpie-noncentred", "nutpie, non-centred by hand", "with_pymc", _NUTPIE, _NUTS_UNIT,
        _NUTS_SIZES, (50,), (("sampler", "nutpie"), ("form", "noncentred")),
    ),
    Engine(
        "pymc", "PyMC, written plainly", "with_pymc", ("pymc", "pytensor"), _NUTS_UNIT, _NUTS_SIZES, (50,),
        (("sampler", "pymc"), ("form", "centred")),
    ),
    Engine(
        "numpyro", "NumPyro, written plainly", "with_numpyro", ("numpyro", "jax"), _NUTS_UNIT,
        _NUTS_SIZES, (50,), (("form", "centred"),),
    ),
    Engine(
        "numpyro-noncentred", "NumPyro, non-centred by hand", "with_numpyro", ("numpyro", "jax"), _NUTS_UNIT,
        _NUTS_SIZES, (50,), (("form", "noncentred"),),
    ),
)  # fmt: skip


def engine(name: str) -> Engine:
    """Return the engine of that name."""
    for one in ENGINES:
        if one.name == name:
            return one
    known = ", ".join(one.name for one in ENGINES)
    raise UsageError(f"no such engine; they are {known}.", key="engine", value=name)
