"""What a coverage study simulates and refits."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.hierarchy.models import Pooled
from percept.simulate.model import Hyperparameters, TrueValues
from percept.study import Study
from percept.study.posterior import thinned_points
from percept.study.responses import refuse_no_ratio

Array = NDArray[np.float64]
Family = Literal["lognormal", "normal"]


@dataclass(frozen=True, kw_only=True)
class CoveragePlan:
    """Studies to simulate, and how to analyse each."""

    references: tuple[tuple[float, float], ...]  # k, N/m, and b, N·s/m, of the environments tested
    held_out: tuple[float, float] | None = None
    subjects: int = 10  # Per study
    truth: Family = "lognormal"  # Distribution of the simulated users
    family: Family = "lognormal"  # Family of the hierarchical model
    method: Literal["both", "classical"] = "both"  # Which methods are judged
    level: float = 0.99  # As `InferenceTable`
    share: float | None = None  # As `InferenceTable`
    confidence: float = 0.95  # As `InferenceTable`
    tolerance: float = 0.05  # Of the sampler
    values: dict[str, Any] | None = None  # What the studies are drawn from, as `fitted_values` gives it
    device: tuple[float, float] = (1.0, 5.0)
    period: float = 0.001  # Sampling period, s
    frequencies: tuple[float, float, int] = (0.1, 100.0, 31)
    seed: int = 1  # Of the whole

    def __post_init__(self) -> None:
        if len(self.references) < 2:
            raise UsageError("a coverage study needs at least two environments.", value=len(self.references))
        if self.subjects < 2:
            raise UsageError("a coverage study needs at least two subjects.", value=self.subjects)
        if self.values is not None and self.held_out is not None:
            raise UsageError("an environment held out can be drawn from the prior only.")

    @property
    def key(self) -> str:
        """A digest that tells results of different plans apart."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:16]

    def true_values(self) -> TrueValues | None:
        """Return `values` as a record, None where they are drawn from the priors."""
        if self.values is None:
            return None
        parts = {name: _array(value) for name, value in self.values["hyper"].items()}
        rest = {name: np.array(self.values[name]) for name in ("delta", "beta", "sigma", "sigma_e")}
        return TrueValues(hyper=Hyperparameters(**parts), **rest)


def refuse_unfit(study: Study) -> None:
    """Refuse a study whose like cannot be simulated, before anything is sampled."""
    if study.parameters != ("k", "b"):
        raise RefusalError(
            "calibration simulates stiffness and damping together; one of them is missing.",
            hint="Give sessions of both, and leave [inference] parameters out.",
        )
    refuse_no_ratio(study.reference, why="and simulated responses are ratios to it")


def fitted_values(study: Study) -> dict[str, Any]:
    """Take the posterior means of a study as the truth to simulate from."""
    refuse_unfit(study)
    fit = study.fit
    if fit is None or not fit.run.gate.passed or not isinstance(fit.prepared.model, Pooled):
        raise RefusalError(
            "calibration needs a passed Bayesian fit of the sessions.",
            hint='Set method = "both" and pooling = "partial", or calibrate from the prior.',
        )
    model = fit.prepared.model
    points, _ = thinned_points(fit)
    named = {name: values for name, (_, values) in model.scales(points).items()}
    count = len(study.parameters)
    beta = model.laws(points).mean.mean(axis=0).reshape(count, -1).T

    def typical(name: str) -> list[float]:
        values = named.get(name)
        return [0.0] * count if values is None else values.mean(axis=0).tolist()

    def correlation(name: str) -> float:
        return float(named[name].mean()) if name in named else 0.0

    zero = [0.0] * count
    return {
        "hyper": {
            "alpha": beta.mean(axis=0).tolist(),
            "gamma": zero,
            "tau": typical("tau"),
            "sigma_u": typical("sigma_u"),
            "rho_u": correlation("rho_u"),
            "s": typical("s"),
            "kappa": typical("kappa"),
            "omega": typical("omega"),
            "rho_w": correlation("rho_w"),
            "s_e": zero,
            "kappa_e": zero,
            "omega_e": zero,
            "rho_e": 0.0,
        },
        "delta": (beta - beta.mean(axis=0)).tolist(),
        "beta": beta.tolist(),
        "sigma": named["sigma"].mean(axis=0).T.tolist(),
        "sigma_e": np.zeros_like(beta).tolist(),
    }


def _array(value: float | Sequence[float]) -> Any:
    return np.array(value) if isinstance(value, (list, tuple)) else value
