"""The model every engine samples: a study as plain arrays, the joint density, and limits from raw draws.

The joint density is of data, locations and scales, nothing integrated. For subject i in environment j, with
parameter p being k or b and x_jp the reference in decades:
y_ij = alpha + gamma x_j + delta_j + u_i + w_ij, delta_jp ~ N(0, tau_p²), u_i ~ N(0, Sigma_u),
w_ij ~ N(0, Sigma_w,j) with one correlation rho_w and SDs log sigma_jp ~ N(log s_p + kappa_p x_jp, omega_p²).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import UsageError

Array: TypeAlias = NDArray[np.float64]
KINDS = ("mean", "user", "share")
LEVEL, SHARE, CONFIDENCE = 0.99, 0.99, 0.95
_POSITIVE = ("tau", "sigma_u", "omega")
_CORRELATIONS = ("rho_u", "rho_w")
_HALF_NORMAL = {"tau": 0.5, "sigma_u": 0.5, "omega": 1.0}
_NORMAL = {"alpha": (0.0, 1.0), "gamma": (0.0, 0.25), "log_s": (math.log(0.2), 1.0), "kappa": (0.0, 0.5)}


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """Unit-free responses of one study without repeated trials; both parameters."""

    response: Array  # (M, 2) log(adjusted/reference) of k and b, one row per trial
    subject: NDArray[np.intp]  # (M,)
    environment: NDArray[np.intp]  # (M,)
    decades: Array  # (2, J) log10 of each reference over the geometric mean of its parameter's references

    @property
    def subjects(self) -> int:
        """Number of subjects."""
        return int(self.subject.max()) + 1

    @property
    def environments(self) -> int:
        """Number of environments."""
        return self.decades.shape[1]

    @classmethod
    def of_sessions(cls, path: str | Path) -> Self:
        """Read a study."""
        from percept.scene import Scene
        from percept.sessions import read_sessions
        from percept.study.responses import trials

        data = trials(read_sessions(path), Scene(), ("k", "b"))
        cells = np.stack([data.subject, data.environment], axis=1)
        if len(np.unique(cells, axis=0)) < len(cells):
            raise UsageError(
                "a subject has several trials in one environment; the models compared have no trial level.",
                file=str(path),
                hint="Compare on a study with one trial per subject and environment.",
            )
        return cls(data.response, data.subject, data.environment, data.x)

    def save(self, path: str | Path) -> None:
        """Write an .npz file, so that a peer's process needs numpy alone to start."""
        np.savez(path, **{field.name: getattr(self, field.name) for field in dataclasses.fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Undo `save`."""
        with np.load(path) as stored:
            return cls(**{field.name: stored[field.name] for field in dataclasses.fields(cls)})


def shapes(study: Responses) -> dict[str, tuple[int, ...]]:
    """Shape of every unknown of the model, parameters first."""
    cell, person = (2, study.environments), (2, study.subjects)
    single = dict.fromkeys(("alpha", "gamma", "tau", "sigma_u", "log_s", "kappa", "omega"), (2,))
    return single | dict.fromkeys(_CORRELATIONS, ()) | {"delta": cell, "log_sigma": cell, "u": person}


def log_joint(study: Responses, values: Mapping[str, Array]) -> Array:
    """Log density of data and unknowns together, with every constant."""
    x = study.decades[..., None]
    total = np.zeros(np.shape(values["rho_u"]))
    for name, (location, sd) in _NORMAL.items():
        total = total + _normal(values[name] - location, sd).sum(axis=0)
    for name, scale in _HALF_NORMAL.items():
        total = total + (_normal(values[name], scale) + math.log(2.0)).sum(axis=0)
    for name in _CORRELATIONS:
        total = total + np.log(0.75 * (1.0 - values[name] ** 2))  # Beta(2, 2) on (-1, 1)
    total = total + _normal(values["delta"], values["tau"][:, None]).sum(axis=(0, 1))
    centre = values["log_s"][:, None] + values["kappa"][:, None] * x
    total = total + _normal(values["log_sigma"] - centre, values["omega"][:, None]).sum(axis=(0, 1))
    total = total + _pair(values["u"], values["sigma_u"][:, None], values["rho_u"]).sum(axis=0)
    beta = values["alpha"][:, None] + values["gamma"][:, None] * x + values["delta"]
    rest = study.response.T[..., None] - beta[:, study.environment] - values["u"][:, study.subject]
    sigma = np.exp(values["log_sigma"])[:, study.environment]
    return total + _pair(rest, sigma, values["rho_w"]).sum(axis=0)


def _normal(off: Array, sd: Array | float) -> Array:
    return -0.5 * (off / sd) ** 2 - np.log(sd) - 0.5 * math.log(2.0 * math.pi)


def _pair(off: Array, sd: Array, rho: Array) -> Array:
    """Bivariate normal: the first component, then the second given the first."""
    slope = rho * sd[1] / sd[0]
    return _normal(off[0], sd[0]) + _normal(off[1] - slope * off[0], sd[1] * np.sqrt(1.0 - rho**2))


class PlainDensity:
    """The joint density over one vector of unbounded coordinates, as emcee wants it.

    Positive unknowns enter by their logarithm, correlations by atanh, with the Jacobians.
    """

    def __init__(self, study: Responses) -> None:
        self.study = study
        self._shapes = shapes(study)
        #: Coordinates of every unknown, in their order.
        self.sizes = {name: math.prod(shape) for name, shape in self._shapes.items()}
        self._ends = np.cumsum(list(self.sizes.values()))[:-1]
        self.dimension = sum(self.sizes.values())

    def unknowns(self, points: Array) -> dict[str, Array]:
        """Coordinates (W, dimension) to unknowns, draws last."""
        parts = np.split(points.T, self._ends)
        values = {
            name: part.reshape(*shape, -1)
            for (name, shape), part in zip(self._shapes.items(), parts, strict=True)
        }
        with np.errstate(over="ignore"):
            values |= {name: np.exp(values[name]) for name in _POSITIVE}
        return values | {name: np.tanh(values[name]) for name in _CORRELATIONS}

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, dimension), shape (W,); -inf where doubles overflow."""
        values = self.unknowns(points)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            total = log_joint(self.study, values)
            for name in _POSITIVE:
                total = total + np.log(values[name]).sum(axis=0)
            for name in _CORRELATIONS:
                total = total + np.log1p(-(values[name] ** 2))
        return np.where(np.isfinite(total), total, -np.inf)

    def start(self, walkers: int, rng: np.random.Generator) -> Array:
        """Draw starting points (walkers, dimension): a ball about what the data's means and SDs suggest."""
        by_cell = np.stack(
            [self.study.response[self.study.environment == j] for j in range(self.study.environments)]
        )
        centre = {name: np.zeros(shape) for name, shape in self._shapes.items()}
        centre["delta"] = by_cell.mean(axis=1).T
        centre["log_sigma"] = np.log(by_cell.std(axis=1, ddof=1)).T
        centre["log_s"] = centre["log_sigma"].mean(axis=1)
        for name in _POSITIVE:
            centre[name] = np.full(2, math.log(0.5 * _HALF_NORMAL[name]))
        flat = np.concatenate([np.ravel(centre[name]) for name in self._shapes])
        return flat + 0.1 * rng.standard_normal((walkers, self.dimension))


def population(values: Mapping[str, Array], decades: Array) -> tuple[Array, Array]:
    """Mean of the population and SD of its members in every cell, each (S, 2 J), parameter-major."""
    beta = values["alpha"][:, None] + values["gamma"][:, None] * decades[..., None] + values["delta"]
    spread = np.hypot(values["sigma_u"][:, None], np.exp(values["log_sigma"]))
    cells = beta.shape[0] * beta.shape[1]
    return beta.reshape(cells, -1).T, spread.reshape(cells, -1).T


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Limits on the response scale."""

    value: Array  # (3, 2, C) Kinds, lower and upper, cells (parameter-major)
    error: Array  # (3, 2, C) Monte Carlo standard errors
    effective: float  # Effective draws of the slowest quantity behind them


def share_half_widths(off: Array, spread: Array, share: float = SHARE) -> Array:
    """Half-width h with Phi((h - off)/spread) - Phi((-h - off)/spread) = share."""
    apart = np.abs(off) / spread
    t = np.maximum(apart + special.ndtri(share), special.ndtri(0.5 * (1.0 + share)))
    for _ in range(30):
        missing = special.ndtr(apart - t) + special.ndtr(-apart - t) - (1.0 - share)
        rate = np.exp(-0.5 * (t - apart) ** 2) + np.exp(-0.5 * (t + apart) ** 2)
        step = missing * np.sqrt(2.0 * np.pi) / rate
        t = t + step
        if np.all(np.abs(step) <= 1e-14 * t):
            break
    return t * spread


def limits_of_draws(beta: Array, spread: Array, rng: np.random.Generator) -> Limits:
    """Quantiles of draws."""
    from arviz_stats.base.array import BaseArray

    array_stats: Any = BaseArray()
    tails = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
    user = beta + spread * rng.standard_normal(beta.shape)
    centre = beta.mean(axis=(0, 1))
    half = share_half_widths(beta - centre, spread)
    h = np.quantile(half, CONFIDENCE, axis=(0, 1))
    quantiles = [np.quantile(draws, tails, axis=(0, 1)) for draws in (beta, user)]
    value = np.stack([*quantiles, np.stack([centre - h, centre + h])])

    def chains(draws: Array) -> Array:
        return np.moveaxis(draws, -1, 0)

    def quantile_error(draws: Array, prob: float) -> Array:
        return np.asarray(array_stats.mcse(chains(draws), method="quantile", prob=prob))

    errors = [[quantile_error(draws, tail) for tail in tails] for draws in (beta, user)]
    of_share = np.hypot(
        quantile_error(half, CONFIDENCE), np.asarray(array_stats.mcse(chains(beta), method="mean"))
    )
    # 5 and 95 %: the tails whose draws are counted since Vehtari et al. (2021).
    effective = [
        np.asarray(array_stats.ess(chains(draws), method=method, **how))
        for draws in (beta, np.log(spread))
        for method, how in (("bulk", {}), ("tail", {"prob": (0.05, 0.95)}))
    ]
    return Limits(value, np.stack([*errors, [of_share, of_share]]), float(np.nanmin(effective)))
