"""From coordinates to the scales and correlations of the model, with their prior density."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, block
from percept.inference.hierarchy.priors import LIMIT, Priors, correlation, half_normal
from percept.inference.hierarchy.rough_likelihood import likelihood_between, likelihood_of_trials
from percept.inference.hierarchy.spreads import TiedSpreads
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["Layout", "Options", "Scales"]

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
        return Scales(
            between=self.between[..., draws],
            shared=None if self.shared is None else self.shared[draws],
            trial=None if self.trial is None else self.trial[..., draws],
            tau=None if self.tau is None else tuple(tau[draws] for tau in self.tau),
            named={name: value[..., draws] for name, value in self.named.items()},
            log_prior=self.log_prior[draws],
        )


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
        return f"rho{self.suffix or '_w'}"


class Layout:
    """Order of the coordinates and their map to `Scales`."""

    def __init__(
        self,
        statistics: Statistics,
        priors: Priors,
        options: Options,
    ) -> None:
        self.statistics = statistics
        self.priors = priors
        self.options = options
        self.parameters = len(statistics.parameters)
        self.environments = len(statistics.environments)
        self.trend = self.environments > 1
        self.subject_effect = options.subject_effect and self.trend and not statistics.summary
        self._common_spread = options.common_spread and self.trend
        suffixes = ("", "_e") if statistics.repeats else ("",)
        self._levels = [self._level(suffix) for suffix in suffixes]
        self._slots: dict[str, slice] = {}
        self.names: list[str] = []
        self._name_coordinates()
        self.dimension = len(self.names)
        self._half_normal: dict[str, float] = {}
        for name in ("omega", "omega_e", "sigma_u", "tau"):
            if name in self._slots:
                self._half_normal[name] = getattr(priors, f"{name}_scale")
        self._correlations = [name for name in ("rho_w", "rho_e", "rho_u") if name in self._slots]
        self._log_constant = -0.5 * _LOG_2PI * self.dimension
        #: (d,) Distance from zero beyond which a coordinate has no mass.
        self.limits = np.full(self.dimension, LIMIT)
        standard = np.full(self.dimension, True)
        if not self._common_spread:
            for level in self._levels:
                sigma = self._slots[f"sigma{level.suffix}"]
                # A unit of these is as short as the rough likelihood is narrow.
                self.limits[sigma] *= np.sqrt(1.0 + level.spreads.weight.ravel())
                standard[sigma] = False
        #: Coordinates that are standard normal whatever the rest.
        self._standard = np.flatnonzero(standard)

    def _level(self, suffix: str) -> _Level:
        statistics = self.statistics
        centre = getattr(self.priors, f"log_s{suffix}_mean")
        log_s_sd = getattr(self.priors, f"log_s{suffix}_sd")
        kappa_sd = getattr(self.priors, f"kappa{suffix}_sd")
        loadings = np.zeros((self.parameters, 2, self.environments))
        if self.trend:
            loadings[:, 0] = log_s_sd
        if self.trend and not self.options.weber:
            loadings[:, 1] = kappa_sd * statistics.x
        if suffix:
            rough = likelihood_of_trials(statistics)
        else:
            rough = likelihood_between(
                statistics, loadings, centre, log_s_sd, subject_effect=self.subject_effect
            )
        spreads = TiedSpreads(centre, loadings, rough)
        return _Level(suffix, centre, log_s_sd, kappa_sd, loadings, spreads)

    def _name_coordinates(self) -> None:
        """Give every coordinate its name, and every scale its coordinates."""
        parameters = self.statistics.parameters
        pair = len(parameters) == 2
        for level in self._levels:
            self._name_level(level)
            if pair:
                self._name(level.rho)
        if self.subject_effect:
            self._name("sigma_u", parameters)
            if pair:
                self._name("rho_u")
        if self.trend:
            self._name("tau", parameters)

    def _name_level(self, level: _Level) -> None:
        parameters = self.statistics.parameters
        if not self._common_spread:
            self._name(f"sigma{level.suffix}", parameters, self.statistics.environments)
        if not self.trend:
            return
        self._name(f"log_s{level.suffix}", parameters)
        if not self.options.weber:
            self._name(f"kappa{level.suffix}", parameters)
        if not self._common_spread:
            self._name(f"omega{level.suffix}", parameters)

    def _name(self, scale: str, *axes: tuple[str, ...]) -> None:
        """Append the coordinates of a scale, one for each combination of labels."""
        labels = [",".join(label) for label in itertools.product(*axes)]
        first = len(self.names)
        self._slots[scale] = slice(first, first + len(labels))
        self.names += [f"{scale}[{label}]" if label else scale for label in labels]

    @property
    def priors_in_force(self) -> dict[str, float]:
        """Priors the model uses, by their names in `Priors`."""
        used = {"alpha", *self._slots}
        used |= {f"log_s{level.suffix}" for level in self._levels}
        if self.trend:
            used.add("gamma")
        if self._correlations:
            used.add("rho")
        priors = vars(self.priors)
        return {name: v for name, v in priors.items() if name.rpartition("_")[0] in used}

    def scales(self, coords: Array) -> Scales:
        """Map coordinates (d, W) to scales."""
        named: dict[str, Array] = {}
        one_minus_size: dict[str, Array] = {}
        for name, scale in self._half_normal.items():
            named[name] = half_normal(coords[self._slots[name]], scale)
        for name in self._correlations:
            u = coords[self._slots[name].start]
            named[name], one_minus_size[name] = correlation(u, self.priors.rho_shape)
        standard = coords[self._standard]
        log_prior = self._log_constant - 0.5 * np.einsum("dw,dw->w", standard, standard)
        blocks: dict[str, Block] = {}
        for level in self._levels:
            sd, log_density = self._level_sd(level, coords, named)
            log_prior = log_prior + log_density
            rho = named.get(level.rho)
            blocks[level.suffix] = block(tuple(sd), rho, one_minus_size.get(level.rho))
        shared = None
        if self.subject_effect:
            sd_u = tuple(named["sigma_u"])
            shared = block(sd_u, named.get("rho_u"), one_minus_size.get("rho_u"))
        return Scales(
            between=blocks[""],
            shared=shared,
            trial=blocks.get("_e"),
            tau=tuple(named["tau"]) if self.trend else None,
            named=named,
            log_prior=log_prior,
        )

    def _level_sd(
        self,
        level: _Level,
        coords: Array,
        named: dict[str, Array],
    ) -> tuple[Array, Array | float]:
        """SDs of one level, shape (P, J, W), and the log density of their coordinates."""
        suffix = level.suffix
        width = coords.shape[1]
        trend = np.zeros((self.parameters, 2, width))
        for multiple, name in enumerate((f"log_s{suffix}", f"kappa{suffix}")):
            if name in self._slots:
                trend[:, multiple] = coords[self._slots[name]]
        log_density: Array | float = 0.0
        if self._common_spread:
            log_sigma = level.centre + np.swapaxes(level.loadings, 1, 2) @ trend
        else:
            flat = coords[self._slots[f"sigma{suffix}"]]
            u = flat.reshape(self.parameters, self.environments, width)
            # Without a trend log sigma is about its prior mean, with the prior SD of log s.
            alone = np.full((self.parameters, width), level.log_s_sd)
            omega = named.get(f"omega{suffix}", alone)
            spreads = level.spreads(u, omega, trend)
            log_sigma = spreads.log_sigma
            trend = spreads.multiples
            log_density = spreads.log_density
        if self.trend:
            named[f"s{suffix}"] = np.exp(level.centre + level.log_s_sd * trend[:, 0])
        if self.trend and not self.options.weber:
            named[f"kappa{suffix}"] = level.kappa_sd * trend[:, 1]
        sigma = np.exp(log_sigma)
        named[f"sigma{suffix}"] = sigma
        return sigma, log_density
