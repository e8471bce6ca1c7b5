"""From coordinates to the scales and correlations of the model, with their prior density."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import Block, Vector, block
from percept.inference.hierarchy.priors import LIMIT, Priors, SpreadMap, Spreads, correlation, half_normal
from percept.inference.hierarchy.statistics import Statistics

Array = NDArray[np.float64]
_LOG_2PI = float(np.log(2.0 * np.pi))
_TINY = 1e-300
#: Largest correlation of k and b that coordinates follow.
_MOST_TIED = 0.9999
#: Of log sigma about its trend, where the rough likelihood is taken, and Newton steps towards that place.
_TYPICAL_OMEGA, _ROUGH_STEPS = 0.5, 40
#: Cells that say less than this of log sigma, against a prior's 1, are left to the prior.
_LEAST_WEIGHT = 0.1


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
            self.between[..., draws],
            None if self.shared is None else self.shared[draws],
            None if self.trial is None else self.trial[..., draws],
            None if self.tau is None else tuple(tau[draws] for tau in self.tau),
            {name: value[..., draws] for name, value in self.named.items()},
            self.log_prior[draws],
        )


@dataclasses.dataclass(frozen=True)
class _Level:
    """Names and priors of one level's SDs: between subjects, or between trials."""

    suffix: str
    log_s_mean: float
    log_s_sd: float
    kappa_sd: float
    omega_scale: float


class Layout:
    """Order of the coordinates and their map to `Scales`."""

    def __init__(self, statistics: Statistics, priors: Priors, options: Options) -> None:
        self.statistics = statistics
        self.priors = priors
        self.options = options
        self.parameters = len(statistics.parameters)
        self.environments = len(statistics.environments)
        self.trend = self.environments > 1
        self.subject_effect = options.subject_effect and self.trend and not statistics.summary
        self.weber = options.weber
        self.common_spread = options.common_spread and self.trend
        self.levels = [_Level("", priors.log_s_mean, priors.log_s_sd, priors.kappa_sd, priors.omega_scale)]
        if statistics.repeats:
            self.levels.append(
                _Level("_e", priors.log_s_e_mean, priors.log_s_e_sd, priors.kappa_e_sd, priors.omega_e_scale)
            )
        rough = [self._rough_between(), self._rough_trial()][: len(self.levels)]
        ties = [self._tie_between(), self._tie_trial()]
        self._spreads = [
            _TiedSpreads(level.log_s_mean, self._loadings(level), *likelihood, tie)
            for level, likelihood, tie in zip(self.levels, rough, ties, strict=False)
        ]
        self._slots: dict[str, slice] = {}
        self.names: list[str] = []
        for level in self.levels:
            self._add_level(level)
        if self.subject_effect:
            self._add("sigma_u", self._per_parameter("sigma_u"))
            if self.parameters == 2:
                self._add("rho_u", ["rho_u"])
        if self.trend:
            self._add("tau", self._per_parameter("tau"))
        scales = {"omega": priors.omega_scale, "omega_e": priors.omega_e_scale}
        scales |= {"sigma_u": priors.sigma_u_scale, "tau": priors.tau_scale}
        self._half_normal = [(name, scale) for name, scale in scales.items() if name in self._slots]
        self._correlations = [name for name in ("rho_w", "rho_e", "rho_u") if name in self._slots]
        sigma = [self._slots[name] for name in ("sigma", "sigma_e") if name in self._slots]
        self._standard = np.delete(np.arange(self.dimension), np.r_[tuple(sigma)] if sigma else [])
        self._log_constant = -0.5 * _LOG_2PI * self.dimension
        self.limits = np.full(self.dimension, LIMIT)
        for level, spread in zip(self.levels, self._spreads, strict=True):
            if "sigma" + level.suffix in self._slots:
                # A unit of these is as short as the rough likelihood is narrow.
                self.limits[self._slots["sigma" + level.suffix]] *= np.sqrt(1.0 + spread.weight.ravel())

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    @property
    def priors_in_force(self) -> dict[str, float]:
        """Priors the model has a use for, by their names in `Priors`."""
        names = ["alpha_sd"]
        names += ["gamma_sd", "tau_scale"] if self.trend else []
        names += ["sigma_u_scale"] if self.subject_effect else []
        for level in self.levels:
            e = level.suffix
            names += [f"log_s{e}_mean", f"log_s{e}_sd"]
            names += [f"kappa{e}_sd"] if self.trend and not self.weber else []
            names += [f"omega{e}_scale"] if self.trend and not self.common_spread else []
        names += ["rho_shape"] if self._correlations else []
        return {name: getattr(self.priors, name) for name in names}

    def _per_parameter(self, name: str) -> list[str]:
        return [f"{name}[{p}]" for p in self.statistics.parameters]

    def _add(self, key: str, names: list[str]) -> None:
        self._slots[key] = slice(len(self.names), len(self.names) + len(names))
        self.names.extend(names)

    def _add_level(self, level: _Level) -> None:
        if not self.common_spread:
            names = [
                f"sigma{level.suffix}[{p},{environment}]"
                for p in self.statistics.parameters
                for environment in self.statistics.environments
            ]
            self._add("sigma" + level.suffix, names)
        if self.trend:
            self._add("log_s" + level.suffix, self._per_parameter("log_s" + level.suffix))
            if not self.weber:
                self._add("kappa" + level.suffix, self._per_parameter("kappa" + level.suffix))
            if not self.common_spread:
                self._add("omega" + level.suffix, self._per_parameter("omega" + level.suffix))
        if self.parameters == 2:
            self._add("rho_w" if not level.suffix else "rho_e", ["rho_w" if not level.suffix else "rho_e"])

    def _rough_between(self) -> tuple[Array, Array]:
        sd, df = self.statistics.sd, self.statistics.df
        if self.subject_effect:
            apart, apart_df = _within_subjects(self.statistics.cell_means)
            # Scatter that is the subjects' own says nothing of sigma.
            less = (apart > 0) & (apart < sd)
            sd, df = np.where(less, apart, sd), np.where(less, apart_df, df)
        return self._rough_likelihood(sd, df, self._trial_noise() ** 2)

    def _rough_likelihood(self, sd: Array, df: Array, noise: Array) -> tuple[Array, Array]:
        """Return a normal likelihood of log sigma, mean and weight (P, J), that is right near its mode.

        A scatter sd² with df degrees of freedom has the mean sigma² + noise. Where noise explains most of
        it, a cell by itself says next to nothing, and its chance remainder would put the coordinate
        anywhere: the likelihood is taken at the mode that all cells have together.
        """
        level, known = self.levels[0], sd > 0
        loadings = self._loadings(level)
        spread = _TYPICAL_OMEGA if self.trend else level.log_s_sd
        prior = np.swapaxes(loadings, 1, 2) @ loadings + spread**2 * np.eye(self.environments)
        precision = np.linalg.inv(prior)
        log_sigma = np.full(sd.shape, level.log_s_mean)
        for _ in range(_ROUGH_STEPS):
            left = 1.0 / (1.0 + noise * np.exp(-2.0 * log_sigma))
            weight = np.where(known, 2.0 * df * left * left, 0.0)
            short = np.where(known, sd * sd * left * np.exp(-2.0 * log_sigma) - 1.0, 0.0)
            score = df * left * short - (precision @ (log_sigma - level.log_s_mean)[..., None])[..., 0]
            information = precision + weight[..., None] * np.eye(self.environments)
            step = np.linalg.solve(information, score[..., None])[..., 0]
            log_sigma = log_sigma + np.clip(step, -1.0, 1.0)
        half = np.where(left > 0, 0.5 * short / np.maximum(left, _TINY), 0.0)
        informed = weight > _LEAST_WEIGHT
        return np.where(informed, log_sigma + half, 0.0), np.where(informed, weight, 0.0)

    def _rough_trial(self) -> tuple[Array, Array]:
        df = np.broadcast_to(self.statistics.trial_df, (self.parameters, self.environments))
        scatter = np.sqrt((self.statistics.trial_rows**2).sum(axis=1) / np.maximum(df, 1))
        return np.where(scatter > 0, np.log(np.where(scatter > 0, scatter, 1.0)), 0.0), np.where(
            scatter > 0, 2.0 * df, 0.0
        )

    def _tie_between(self) -> float:
        """Correlation of the rough log SDs of k and b between subjects, by their cell means' departures."""
        if self.parameters < 2:
            return 0.0
        means = self.statistics.cell_means
        pairs = np.asarray(np.isfinite(means).all(axis=1, keepdims=True))
        off = _centred(means, pairs, 2) if self.subject_effect else means
        off = _centred(off, pairs, 0)
        # Each environment weighs by its degrees of freedom, whatever its spread.
        size = np.sqrt(np.square(off).sum(axis=0) / np.maximum(pairs.sum(axis=0) - 1.0, 1.0))
        k, b = np.moveaxis(off / np.where(size > 0, size, 1.0), 1, 0)
        return _tie(k.ravel(), b.ravel(), float(self.statistics.df.min(axis=0).sum()))

    def _tie_trial(self) -> float:
        """Correlation of the rough log SDs of k and b between trials."""
        if self.parameters < 2:
            return 0.0
        rows, df = self.statistics.trial_rows, self.statistics.trial_df
        size = np.sqrt(np.square(rows).sum(axis=1, keepdims=True) / np.maximum(df, 1.0))
        k, b = rows / np.where(size > 0, size, 1.0)
        return _tie(k.ravel(), b.ravel(), float(df.sum()))

    def _trial_noise(self) -> Array:
        """SD that the scatter between trials gives to a cell's means, (P, J); zero without repeats."""
        df = self.statistics.trial_df
        squares = (self.statistics.trial_rows**2).sum(axis=1)
        # An environment without repeats takes the variance that the others have together.
        pooled = squares.sum(axis=1, keepdims=True) / max(df.sum(), 1.0)
        variance = np.where(df > 0, squares / np.maximum(df, 1.0), pooled)
        subjects, shares = np.zeros(self.environments), np.zeros(self.environments)
        for pattern in self.statistics.patterns:
            subjects[pattern.environments] += pattern.subjects
            shares[pattern.environments] += pattern.subjects / pattern.trials
        return np.sqrt(variance * shares / subjects)

    def scales(self, coords: Array) -> Scales:
        """Map coordinates to scales."""
        named = {name: half_normal(coords[self._slots[name]], scale) for name, scale in self._half_normal}
        rest: dict[str, Array] = {}
        for name in self._correlations:
            named[name], rest[name] = correlation(coords[self._slots[name].start], self.priors.rho_shape)
        log_prior = self._log_constant - 0.5 * np.einsum(
            "dw,dw->w", coords[self._standard], coords[self._standard]
        )
        blocks: dict[str, Block] = {}
        for level, spread in zip(self.levels, self._spreads, strict=True):
            sd, log_density = self._level_sd(level, spread, coords, named)
            log_prior = log_prior + log_density
            rho_name = "rho_e" if level.suffix else "rho_w"
            blocks[level.suffix] = block(tuple(sd), named.get(rho_name), rest.get(rho_name))
        shared = None
        if self.subject_effect:
            shared = block(tuple(named["sigma_u"]), named.get("rho_u"), rest.get("rho_u"))
        tau = tuple(named["tau"]) if self.trend else None
        return Scales(blocks[""], shared, blocks.get("_e"), tau, named, log_prior)

    def _level_sd(
        self, level: _Level, spread: _TiedSpreads, coords: Array, named: dict[str, Array]
    ) -> tuple[Array, Array]:
        """SDs of one level, shape (P, J, W), and the log density of their coordinates."""
        suffix = level.suffix
        width = coords.shape[1]
        shape = (self.parameters, self.environments, width)
        trend = np.zeros((self.parameters, 2, width))
        if self.trend:
            trend[:, 0] = coords[self._slots["log_s" + suffix]]
            if not self.weber:
                trend[:, 1] = coords[self._slots["kappa" + suffix]]
        if self.common_spread:
            value = level.log_s_mean + np.swapaxes(self._loadings(level), 1, 2) @ trend
            log_density = np.zeros(width)
        else:
            omega = (
                named["omega" + suffix] if self.trend else np.full((self.parameters, width), level.log_s_sd)
            )
            found = spread(coords[self._slots["sigma" + suffix]].reshape(shape), omega, trend)
            value, trend, log_density = found.log_sigma, found.trend, found.log_density
        if self.trend:
            named["s" + suffix] = np.exp(level.log_s_mean + level.log_s_sd * trend[:, 0])
            if not self.weber:
                named["kappa" + suffix] = level.kappa_sd * trend[:, 1]
        named["sigma" + suffix] = np.exp(value)
        return named["sigma" + suffix], log_density

    def _loadings(self, level: _Level) -> Array:
        """Return what a prior SD of log s and of kappa adds to log sigma, shape (P, 2, J)."""
        loadings = np.zeros((self.parameters, 2, self.environments))
        if self.trend:
            loadings[:, 0] = level.log_s_sd
            loadings[:, 1] = 0.0 if self.weber else level.kappa_sd * self.statistics.x
        return loadings


def _centred(values: Array, present: NDArray[np.bool_], axis: int) -> Array:
    """Values less their mean along an axis, zero where not present."""
    count = np.maximum(present.sum(axis=axis, keepdims=True), 1)
    mean = np.where(present, values, 0.0).sum(axis=axis, keepdims=True) / count
    return np.where(present, values - mean, 0.0)


def _tie(k: Array, b: Array, df: float) -> float:
    """Square of a correlation, two standard errors of its Fisher transform nearer to zero.

    Log SDs of samples of pairs with correlation rho are correlated by rho².
    """
    size = math.sqrt(float(k @ k) * float(b @ b))
    if df <= 3.0 or size == 0.0:
        return 0.0
    score = math.atanh(min(abs(float(k @ b)) / size, _MOST_TIED)) - 2.0 / math.sqrt(df - 3.0)
    return math.tanh(max(score, 0.0)) ** 2


class _TiedSpreads:
    """Spreads of one level of one parameter or two, the second's written given the first's.

    Where k and b go together so do their sample SDs: the rough likelihood of log sigma of b is N(l + slope
    (log sigma of k - its l), (1 - tie²)/w). Near a correlation of one the ratio of the two is known far
    better than either, and no linear map of separate coordinates follows it.
    """

    def __init__(
        self, centre: float, loadings: Array, rough_mean: Array, rough_weight: Array, tie: float
    ) -> None:
        known = (rough_weight > 0).all(axis=0)
        self.weight = rough_weight.copy()
        self.weight[1:] /= np.where(known, 1.0 - tie * tie, 1.0)
        rows = [slice(p, p + 1) for p in range(len(loadings))]
        self._maps = [SpreadMap(centre, loadings[p], rough_mean[p], self.weight[p]) for p in rows]
        ratio = rough_weight[0] / np.where(known, rough_weight[-1], 1.0)
        self._slope = np.where(known, tie * np.sqrt(ratio), 0.0)[:, None]
        self._mean = rough_mean[0][:, None]

    def __call__(self, u: Array, omega: Array, trend: Array) -> Spreads:
        """Map coordinates (P, J, W), given omega (P, W) and the trend (P, 2, W), to spreads."""
        found = self._maps[0](u[:1], omega[:1], trend[:1])
        if len(self._maps) == 1:
            return found
        shift = self._slope * (found.log_sigma - self._mean)
        given = self._maps[1](u[1:], omega[1:], trend[1:], shift)
        return Spreads(
            np.concatenate([found.log_sigma, given.log_sigma]),
            np.concatenate([found.trend, given.trend]),
            found.log_density + given.log_density,
        )


def _within_subjects(cell_means: Array) -> tuple[Array, Array]:
    """SD per cell without the subjects' means, (P, J), and its degrees of freedom, of means (N, P, J)."""
    several = np.isfinite(cell_means).all(axis=1).sum(axis=1) > 1
    values = cell_means[several]
    present = np.isfinite(values)
    rest = _centred(_centred(values, present, 0), present, 2)
    count, seen = present.sum(axis=0), present.sum(axis=2, keepdims=True)
    kept = np.where(present, 1.0 - 1.0 / np.maximum(seen, 1), 0.0).sum(axis=0)
    # Of the count - 1 degrees of freedom the subjects' means take their share.
    df = np.maximum(kept * (1.0 - 1.0 / np.maximum(count, 1)), 0.0)
    return np.sqrt((rest**2).sum(axis=0) / np.maximum(df, _TINY)) * (df > 0), df
