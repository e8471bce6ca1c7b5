"""The model written plainly in PyMC, for nutpie: the same limits by another density.

Locations, deviations and subjects' effects are unknowns. Only a subject's departure in an
environment is summed into the scatter of its mean. It needs the extra `peers`.
"""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from arviz_stats.base.array import BaseArray
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import elementwise

from percept.inference.model.priors import Priors
from percept.study.prepare import Prepared

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.intp]
#: A number or an array of PyMC, or of numpy; PyMC has no types.
Term: TypeAlias = Any

#: nutpie's default is 6; R-hat needs several.
CHAINS = 4
#: Of the intervals compared.
LEVEL = 0.99
SHARE = 0.99
CONFIDENCE = 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class Observed:
    """M trials of P quantities in J environments."""

    response: Array  # (M, P)
    subject: Indices  # (M,)
    environment: Indices  # (M,)
    x: Array  # (P, J) Decades of references above their geometric mean

    @property
    def subjects(self) -> int:
        """How many."""
        return int(self.subject.max()) + 1


def observed(study: Prepared) -> Observed:
    """Return a study as the plainly written model takes it."""
    data = study.trials
    assert data is not None
    return Observed(data.response, data.subject, data.environment, data.statistics.x)


class _Plain:
    """Unknowns of the model, written inside a PyMC model; quantities first."""

    def __init__(self, observed: Observed, *, centred: bool) -> None:
        self.observed = observed
        self.priors = Priors()
        self.size, self.count = observed.x.shape
        self.centred = centred

    def normal(self, name: str, sd: Term, *shape: int, centre: Term = 0.0) -> Term:
        """Return normal unknowns of each quantity."""
        import pymc as pm

        return pm.Normal(name, centre, sd, shape=(self.size, *shape))

    def half(self, name: str, scale: float) -> Term:
        """Return a half-normal unknown of each quantity."""
        import pymc as pm

        return pm.HalfNormal(name, scale, shape=self.size)

    def correlation(self, name: str) -> Term:
        """Return the correlation of both quantities; 0 for one."""
        import pymc as pm

        if self.size == 1:
            return 0.0
        shape = self.priors.rho_shape
        return pm.Deterministic(name, 2.0 * pm.Beta(f"half_{name}", shape, shape) - 1.0)

    def about(self, centre: Term, sd: Term, name: str, multiple: str, count: int) -> Term:
        """Return normal values, themselves unknowns or multiples of their SD."""
        if self.centred:
            return self.normal(name, sd[:, None], count, centre=centre)
        return centre + sd[:, None] * self.normal(multiple, 1.0, count)

    def locations(self) -> Term:
        """Return the means of the environments."""
        import pymc as pm

        beta = self.normal("alpha", self.priors.alpha_sd)[:, None]
        beta = beta + self.normal("gamma", self.priors.gamma_sd)[:, None] * self.observed.x
        tau = self.half("tau", self.priors.tau_scale)
        return pm.Deterministic("beta", beta + self.about(0.0, tau, "own_tau", "z_tau", self.count))

    def sds(self, suffix: str) -> Term:
        """Return the SDs of all environments: "" between subjects, "_e" between trials."""
        import pymc as pm

        prior = vars(self.priors)
        sd = prior[f"log_s{suffix}_sd"]
        log_s = self.normal(f"log_s{suffix}", sd, centre=prior[f"log_s{suffix}_mean"])
        kappa = self.normal(f"kappa{suffix}", prior[f"kappa{suffix}_sd"])
        trend = log_s[:, None] + kappa[:, None] * self.observed.x
        omega = self.half(f"omega{suffix}", prior[f"omega{suffix}_scale"])
        log_sigma = self.about(trend, omega, f"log_sigma{suffix}", f"z{suffix}", self.count)
        return pm.Deterministic(f"sigma{suffix}", pm.math.exp(log_sigma))

    def effects(self) -> tuple[Term, Term]:
        """Return what every subject adds to all environments, (P, N), and its SD, (P,)."""
        import pymc as pm

        sd = self.half("sigma_u", self.priors.sigma_u_scale)
        rho = self.correlation("rho_u")
        z = self.normal("z_u", 1.0, self.observed.subjects)
        effects = [sd[0] * z[0]]
        if self.size == 2:
            effects.append(sd[1] * (rho * z[0] + pm.math.sqrt(1.0 - rho**2) * z[1]))
        return pm.math.stack(effects), sd


def plain_model(observed: Observed, *, centred: bool = False) -> Any:
    """Write the model of a study in PyMC.

    Parameters
    ----------
    observed : Observed
        The study.
    centred : bool
        Whether shifts and spreads are unknowns themselves, as a model is plainly written. By
        default they are multiples of their SDs, which leaves no funnel.

    Returns
    -------
    pymc.Model
        `beta` are the means of the environments, and `spread` SDs between users, (P, J).
    """
    # PyMC and nutpie import arviz-plots if it is there. Release 0.8 wants this module, which
    # matplotlib 3.11 no longer imports itself.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import matplotlib.style.core  # noqa: F401
    import pymc as pm

    _, environments = observed.x.shape
    pair, of_trial, trials = np.unique(
        observed.subject * environments + observed.environment,
        return_inverse=True,
        return_counts=True,
    )
    subject, environment = np.divmod(pair, environments)

    def summed(values: Array) -> Array:
        return np.bincount(of_trial, weights=values, minlength=len(pair)).astype(float)

    mean = np.stack([summed(column) / trials for column in observed.response.T])
    departure = observed.response.T - mean[:, of_trial]
    with pm.Model() as model:
        plain = _Plain(observed, centred=centred)
        beta = plain.locations()
        shared, sd_u = plain.effects()
        residual = mean - beta[:, environment] - shared[:, subject]
        sigma = plain.sds("")
        pm.Deterministic("spread", pm.math.sqrt(sd_u[:, None] ** 2 + sigma**2))
        covariance = _covariance(sigma[:, environment], plain.correlation("rho_w"))
        if trials.max() > 1:
            sigma_e = plain.sds("_e")[:, environment]
            within = _covariance(sigma_e, plain.correlation("rho_e"))
            squares = {(p, q): summed(departure[p] * departure[q]) for p, q in within}
            # Departures from a mean of n trials have the density of n - 1 trials.
            pm.Potential("departures", _log_density(squares, within, trials - 1))
            covariance = {key: term + within[key] / trials for key, term in covariance.items()}
        squares = {(p, q): residual[p] * residual[q] for p, q in covariance}
        pm.Potential("means", _log_density(squares, covariance, np.ones(len(pair))))
    return model


_Pairs: TypeAlias = dict[tuple[int, int], Term]


def _covariance(sd: Term, rho: Term) -> _Pairs:
    """Return variances, and the covariance where `rho` is one of two quantities."""
    if isinstance(rho, float):
        return {(0, 0): sd[0] ** 2}
    return {(0, 0): sd[0] ** 2, (1, 1): sd[1] ** 2, (0, 1): rho * sd[0] * sd[1]}


def _log_density(squares: _Pairs, covariance: _Pairs, counts: NDArray[Any]) -> Term:
    """Return the normal log density of sums of squares of so many values, without its constant."""
    import pymc as pm

    if len(covariance) == 1:
        variance = covariance[0, 0]
        return -0.5 * (squares[0, 0] / variance + counts * pm.math.log(variance)).sum()
    first = covariance[0, 0]
    second = covariance[1, 1]
    both = covariance[0, 1]
    determinant = first * second - both**2
    distance = second * squares[0, 0] + first * squares[1, 1] - 2.0 * both * squares[0, 1]
    return -0.5 * (distance / determinant + counts * pm.math.log(determinant)).sum()


@dataclasses.dataclass(frozen=True, eq=False)
class Draws:
    """What nutpie drew, by name: (chains, draws, …). Chains cut short are filled up with NaN."""

    values: Mapping[str, Array]
    divergences: int
    seconds: float  # Wall time of sampling


def nutpie_sampler(model: Any, names: Sequence[str] | None = None) -> Callable[..., Draws]:
    """Compile a model of PyMC for nutpie.

    Parameters
    ----------
    model : pymc.Model
        As `plain_model` writes it.
    names : sequence of str, optional
        Variables that are kept; all by default.

    Returns
    -------
    callable
        Takes the draws of each chain, other arguments of `nutpie.sample`, and as `patience` the
        seconds after which it stops.
    """
    import nutpie

    compiled = nutpie.compile_pymc_model(model, var_names=names)

    def draw(draws: int, *, patience: float | None = None, **options: object) -> Draws:
        started = time.perf_counter()
        sampler = nutpie.sample(
            compiled,
            draws=draws,
            chains=CHAINS,
            progress_bar=False,
            save_warmup=False,
            blocking=False,
            **options,
        )
        try:
            tree = sampler.wait(timeout=patience)
        except TimeoutError:
            tree = sampler.abort()
        seconds = time.perf_counter() - started
        values = {name: np.asarray(tree.posterior[name]) for name in tree.posterior.data_vars}
        return Draws(values, int(np.nansum(tree.sample_stats.diverging)), seconds)

    return draw


def share_half_widths(off: Array, spread: Array, share: float = SHARE) -> Array:
    """Return the half-width h with Phi((h - off)/spread) - Phi((-h - off)/spread) = share."""

    def missing(t: Array, apart: Array) -> Array:
        return special.ndtr(apart - t) + special.ndtr(-apart - t) - (1.0 - share)

    apart = np.abs(off) / spread
    enough = apart + special.ndtri(0.5 * (1.0 + share)) + 1.0
    root = elementwise.find_root(missing, (np.zeros_like(apart), enough), args=(apart,))
    return np.asarray(root.x * spread)


def limits_of_draws(
    beta: Array, spread: Array, rng: np.random.Generator
) -> tuple[Array, Array, float]:
    """Return limits from raw draws, as quantiles.

    Parameters
    ----------
    beta, spread : ndarray, shape (chains, draws, …)
        Of the cells: means of the populations, and their SDs.
    rng : numpy.random.Generator
        Draws new users.

    Returns
    -------
    value, error : ndarray, shape (3, 2, cells)
        Limits of the kinds mean, user and share, and their Monte Carlo standard errors.
    effective : float
        Effective draws of the slowest quantity.
    """
    beta = beta.reshape(*beta.shape[:2], -1)
    spread = spread.reshape(beta.shape)
    array_stats: Any = BaseArray()
    tails = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))

    def error_of_mean(draws: Array) -> Array:
        return np.asarray(array_stats.mcse(np.moveaxis(draws, -1, 0), method="mean"))

    def error_of_quantile(draws: Array, probability: float) -> Array:
        series = np.moveaxis(draws, -1, 0)
        return np.asarray(array_stats.mcse(series, method="quantile", prob=probability))

    value = []
    error = []
    user = beta + spread * rng.standard_normal(beta.shape)
    for draws in (beta, user):
        value.append(np.quantile(draws, tails, axis=(0, 1)))
        error.append([error_of_quantile(draws, tail) for tail in tails])
    centre = beta.mean(axis=(0, 1))
    half = share_half_widths(beta - centre, spread)
    h = np.quantile(half, CONFIDENCE, axis=(0, 1))
    value.append(np.stack([centre - h, centre + h]))
    of_share = np.hypot(error_of_quantile(half, CONFIDENCE), error_of_mean(beta))
    error.append([of_share, of_share])
    effective = []
    for draws in (beta, np.log(spread)):
        series = np.moveaxis(draws, -1, 0)
        effective.append(array_stats.ess(series, method="bulk"))
        # 5 and 95 %: the tails whose draws are counted since Vehtari et al. (2021).
        effective.append(array_stats.ess(series, method="tail", prob=(0.05, 0.95)))
    return np.stack(value), np.stack(error), float(np.nanmin(effective))
