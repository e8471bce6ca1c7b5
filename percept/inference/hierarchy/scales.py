"""From coordinates to the scales and correlations of the model, with their prior density."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, block
from percept.inference.hierarchy.priors import LIMIT, Priors, correlation, half_normal
from percept.inference.hierarchy.spreads import (
    TiedSpreads,
    rough_between,
    rough_trial,
    tie_between,
    tie_trial,
)
from percept.inference.hierarchy.statistics import Statistics

Array = NDArray[np.float64]
_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """Simpler models an analyst can ask for."""

    subject_effect: bool = True  # Whether subjects carry an effect u shared by environments
    weber: bool = False  # Fix kappa = 0: the spread is a constant fraction of the reference
    common_spread: bool = False  # Fix omega = 0: the spread follows its trend exactly


@dataclasses.dataclass(frozen=True, eq=False)
class Scales:
    """Scales and correlations of the model for W draws; P parameters, J environments."""

    between: Block  # Covariance between subjects within an environment, Sigma_w
    shared: Block | None  # Covariance of the subject effect, Sigma_u
    trial: Block | None  # Covariance between trials, Sigma_e
    tau: Vector | None  # (W,) SD of an environment's own bias
    named: dict[str, Array]  # Every scale and correlation by name, (W,), (P, W) or (P, J, W)
    log_prior: Array  # (W,) Prior density of the coordinates

    def __getitem__(self, draws: Any) -> Scales:
        shared = None if self.shared is None else self.shared[draws]
        trial = None if self.trial is None else self.trial[..., draws]
        tau = None if self.tau is None else tuple(tau[draws] for tau in self.tau)
        named = {name: value[..., draws] for name, value in self.named.items()}
        return Scales(self.between[..., draws], shared, trial, tau, named, self.log_prior[draws])


@dataclasses.dataclass(frozen=True)
class _Level:
    """SDs of one level, between subjects or between trials: names, priors and coordinates."""

    suffix: str  # Of names: none between subjects, "_e" between trials
    centre: float  # Prior mean of log s
    log_s_sd: float
    kappa_sd: float
    loadings: Array  # (P, 2, J) What a prior SD of log s and of kappa adds to log sigma
    spreads: TiedSpreads

    @property
    def rho(self) -> str:
        """Name of its correlation."""
        return "rho" + (self.suffix or "_w")


class Layout:
    """Order of the coordinates and their map to `Scales`."""

    def __init__(self, statistics: Statistics, priors: Priors, options: Options) -> None:
        self.statistics, self.priors, self.options = statistics, priors, options
        self.parameters, self.environments = (
            len(statistics.parameters),
            len(statistics.environments),
        )
        self.trend = self.environments > 1
        self.subject_effect = options.subject_effect and self.trend and not statistics.summary
        self._common_spread = options.common_spread and self.trend
        self._levels = [self._level(suffix) for suffix in ("", "_e")[: 1 + statistics.repeats]]
        self._slots: dict[str, slice] = {}
        self.names: list[str] = []
        self._name_coordinates()
        self.dimension = len(self.names)
        scaled = {"omega", "omega_e", "sigma_u", "tau"}
        self._half_normal = {n: getattr(priors, f"{n}_scale") for n in self._slots if n in scaled}
        self._correlations = [name for name in ("rho_w", "rho_e", "rho_u") if name in self._slots]
        self.limits = np.full(self.dimension, LIMIT)
        standard = np.full(self.dimension, True)
        for level in self._levels if not self._common_spread else ():
            sigma = self._slots["sigma" + level.suffix]
            # A unit of these is as short as the rough likelihood is narrow.
            self.limits[sigma] *= np.sqrt(1.0 + level.spreads.weight.ravel())
            standard[sigma] = False
        self._standard = np.flatnonzero(
            standard
        )  # Coordinates that are standard normal whatever the rest
        self._log_constant = -0.5 * _LOG_2PI * self.dimension

    def _level(self, suffix: str) -> _Level:
        statistics, options = self.statistics, self.options
        names = f"log_s{suffix}_mean", f"log_s{suffix}_sd", f"kappa{suffix}_sd"
        centre, log_s_sd, kappa_sd = (getattr(self.priors, name) for name in names)
        loadings = np.zeros((self.parameters, 2, self.environments))
        if self.trend:
            loadings[:, 0] = log_s_sd
            loadings[:, 1] = 0.0 if options.weber else kappa_sd * statistics.x
        if suffix:
            rough, tie = rough_trial(statistics), tie_trial(statistics)
        else:
            effect = self.subject_effect
            rough = rough_between(statistics, loadings, centre, log_s_sd, subject_effect=effect)
            tie = tie_between(statistics, subject_effect=effect)
        spreads = TiedSpreads(centre, loadings, *rough, tie)
        return _Level(suffix, centre, log_s_sd, kappa_sd, loadings, spreads)

    def _name_coordinates(self) -> None:
        """Give every coordinate its name, and every scale its coordinates."""

        def add(key: str, *axes: tuple[str, ...]) -> None:
            labels = [",".join(label) for label in itertools.product(*axes)]
            self._slots[key] = slice(len(self.names), len(self.names) + len(labels))
            self.names.extend(f"{key}[{label}]" if label else key for label in labels)

        each = self.statistics.parameters
        for level in self._levels:
            if not self._common_spread:
                add("sigma" + level.suffix, each, self.statistics.environments)
            if self.trend:
                add("log_s" + level.suffix, each)
            if self.trend and not self.options.weber:
                add("kappa" + level.suffix, each)
            if self.trend and not self._common_spread:
                add("omega" + level.suffix, each)
            if self.parameters == 2:
                add(level.rho)
        if self.subject_effect:
            add("sigma_u", each)
            if self.parameters == 2:
                add("rho_u")
        if self.trend:
            add("tau", each)

    @property
    def priors_in_force(self) -> dict[str, float]:
        """Priors the model has a use for, by their names in `Priors`."""
        used = {"alpha", *self._slots, *("log_s" + level.suffix for level in self._levels)}
        used |= {"gamma"} if self.trend else set()
        used |= {"rho"} if self._correlations else set()
        return {name: v for name, v in vars(self.priors).items() if name.rpartition("_")[0] in used}

    def scales(self, coords: Array) -> Scales:
        """Map coordinates to scales."""
        named = {
            name: half_normal(coords[self._slots[name]], s) for name, s in self._half_normal.items()
        }
        rest: dict[str, Array] = {}
        for name in self._correlations:
            named[name], rest[name] = correlation(
                coords[self._slots[name].start], self.priors.rho_shape
            )
        standard = coords[self._standard]
        log_prior = self._log_constant - 0.5 * np.einsum("dw,dw->w", standard, standard)
        blocks: dict[str, Block] = {}
        for level in self._levels:
            sd, log_density = self._level_sd(level, coords, named)
            log_prior = log_prior + log_density
            blocks[level.suffix] = block(tuple(sd), named.get(level.rho), rest.get(level.rho))
        shared = None
        if self.subject_effect:
            shared = block(tuple(named["sigma_u"]), named.get("rho_u"), rest.get("rho_u"))
        tau = tuple(named["tau"]) if self.trend else None
        return Scales(blocks[""], shared, blocks.get("_e"), tau, named, log_prior)

    def _level_sd(
        self, level: _Level, coords: Array, named: dict[str, Array]
    ) -> tuple[Array, Array | float]:
        """SDs of one level, shape (P, J, W), and the log density of their coordinates."""
        e, width = level.suffix, coords.shape[1]
        trend = np.zeros((self.parameters, 2, width))
        for multiple, name in enumerate(("log_s" + e, "kappa" + e)):
            if name in self._slots:
                trend[:, multiple] = coords[self._slots[name]]
        if self._common_spread:
            log_sigma = level.centre + np.swapaxes(level.loadings, 1, 2) @ trend
            log_density: Array | float = 0.0
        else:
            u = coords[self._slots["sigma" + e]].reshape(self.parameters, self.environments, width)
            omega = named.get("omega" + e, np.full((self.parameters, width), level.log_s_sd))
            log_sigma, trend, log_density = level.spreads(u, omega, trend)
        if self.trend:
            named["s" + e] = np.exp(level.centre + level.log_s_sd * trend[:, 0])
            if not self.options.weber:
                named["kappa" + e] = level.kappa_sd * trend[:, 1]
        named["sigma" + e] = np.exp(log_sigma)
        return named["sigma" + e], log_density
