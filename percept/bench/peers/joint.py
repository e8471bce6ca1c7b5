"""The hierarchical model written out: the joint density of data, locations and scales, nothing integrated.

For subject i in environment j, with parameter p being k or b and x_jp the reference in decades:
y_ij = alpha + gamma x_j + delta_j + u_i + w_ij, delta_jp ~ N(0, tau_p²), u_i ~ N(0, Sigma_u),
w_ij ~ N(0, Sigma_w,j) with one correlation rho_w and SDs log sigma_jp ~ N(log s_p + kappa_p x_jp, omega_p²).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from percept.bench.peers.responses import Responses

Array = NDArray[np.float64]
_POSITIVE = ("tau", "sigma_u", "omega")
_CORRELATIONS = ("rho_u", "rho_w")
_HALF_NORMAL = {"tau": 0.5, "sigma_u": 0.5, "omega": 1.0}
_NORMAL = {"alpha": (0.0, 1.0), "gamma": (0.0, 0.25), "log_s": (math.log(0.2), 1.0), "kappa": (0.0, 0.5)}


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
