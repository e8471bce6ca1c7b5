"""The whole model written plainly in PyMC, for nutpie: the same limits by another density.

Locations, deviations and subjects' effects are unknowns. Only a subject's departure in a cell is
summed into the scatter of the cell's mean. It needs the extra `peers`.
"""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.priors import Priors

Array: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.intp]
#: A number or an array of PyMC, or of numpy; PyMC has no types.
Term: TypeAlias = Any

#: nutpie's default is 6; R-hat needs several.
CHAINS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Observed:
    """M trials of P quantities in C cells, and what the cells are."""

    response: Array  # (M, P)
    subject: Indices  # (M,)
    cell: Indices  # (M,)
    environment: Indices  # (C,)
    x: Array  # (P, C) Decades of references above their geometric mean
    priors: Priors
    contrast: Mapping[str, Array] = dataclasses.field(default_factory=dict)  # (C,) by term
    own: Mapping[str, Array] = dataclasses.field(default_factory=dict)  # Of those, subjects' own
    factors: Sequence[str] = ()
    spread: Sequence[str] = ()  # Factors whose levels differ in the spread of subjects' effects
    covariate: Array | None = None  # (M,)
    own_trial_sds: bool = False

    @property
    def subjects(self) -> int:
        """How many."""
        return int(self.subject.max()) + 1

    @property
    def columns(self) -> dict[str, Array]:
        """Columns of the subjects' effects over the cells, by name."""
        ones = np.ones(len(self.environment))
        return {"u": ones} | {f"v_{term}": contrast for term, contrast in self.own.items()}


class _Plain:
    """Unknowns of the model, written inside a PyMC model; quantities first."""

    def __init__(self, observed: Observed, *, centred: bool) -> None:
        self.observed = observed
        self.priors = observed.priors
        self.size, self.cells = observed.x.shape
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

    def deviations(self, name: str) -> Term:
        """Return what each environment has of its own, at the cells."""
        tau = self.half(name, self.priors.tau_scale)
        environment = self.observed.environment
        count = int(environment.max()) + 1
        return self.about(0.0, tau, f"own_{name}", f"z_{name}", count)[:, environment]

    def locations(self) -> Term:
        """Return the means of the cells."""
        import pymc as pm

        beta = self.normal("alpha", self.priors.alpha_sd)[:, None]
        beta = beta + self.normal("gamma", self.priors.gamma_sd)[:, None] * self.observed.x
        beta = beta + self.deviations("tau")
        for term, contrast in self.observed.contrast.items():
            coefficient = self.normal(f"lambda_{term}", self.priors.lambda_sd)[:, None]
            beta = beta + contrast * (coefficient + self.deviations(f"tau_{term}"))
        return pm.Deterministic("beta", beta)

    def sds(self, suffix: str) -> Term:
        """Return the SDs of all cells: "" between subjects, "_e" between trials."""
        import pymc as pm

        prior = vars(self.priors)
        sd = prior[f"log_s{suffix}_sd"]
        log_s = self.normal(f"log_s{suffix}", sd, centre=prior[f"log_s{suffix}_mean"])
        kappa = self.normal(f"kappa{suffix}", prior[f"kappa{suffix}_sd"])
        trend = log_s[:, None] + kappa[:, None] * self.observed.x
        for factor in self.observed.factors:
            psi = self.normal(f"psi{suffix}_{factor}", prior["psi_sd"])[:, None]
            trend = trend + psi * self.observed.contrast[factor]
        omega = self.half(f"omega{suffix}", prior[f"omega{suffix}_scale"])
        log_sigma = self.about(trend, omega, f"log_sigma{suffix}", f"z{suffix}", self.cells)
        return pm.Deterministic(f"sigma{suffix}", pm.math.exp(log_sigma))

    def stretch(self) -> Term:
        """Return the sizes of subjects' effects in the cells."""
        import pymc as pm

        log_size: Term = np.zeros((self.size, self.cells))
        for factor in self.observed.spread:
            eta = self.normal(f"eta_{factor}", self.priors.psi_sd)[:, None]
            log_size = log_size + eta * self.observed.contrast[factor]
        return pm.Deterministic("stretch", pm.math.exp(log_size))

    def effects(self, stretch: Term) -> tuple[Term, Term]:
        """Return what every subject adds to the cells, (P, N, C), and its variance, (P, C)."""
        import pymc as pm

        total: Term = 0.0
        variance: Term = 0.0
        for name, contrast in self.observed.columns.items():
            sd = self.half(f"sigma_{name}", self.priors.sigma_u_scale)
            rho = self.correlation(f"rho_{name}")
            z = self.normal(f"z_{name}", 1.0, self.observed.subjects)
            effects = [sd[0] * z[0]]
            if self.size == 2:
                effects.append(sd[1] * (rho * z[0] + pm.math.sqrt(1.0 - rho**2) * z[1]))
            column = stretch * contrast
            total = total + pm.math.stack(effects)[:, :, None] * column[:, None, :]
            variance = variance + (sd[:, None] * column) ** 2
        return total, variance


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
        `beta` are the means of the cells, and `spread` SDs between users, (P, C).
    """
    # PyMC and nutpie import arviz-plots if it is there. Release 0.8 wants this module, which
    # matplotlib 3.11 no longer imports itself.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import matplotlib.style.core  # noqa: F401
    import pymc as pm

    size, cells = observed.x.shape
    pair, of_trial, trials = np.unique(
        observed.subject * cells + observed.cell, return_inverse=True, return_counts=True
    )
    subject, cell = np.divmod(pair, cells)

    def summed(values: Array) -> Array:
        return np.bincount(of_trial, weights=values, minlength=len(pair)).astype(float)

    mean = np.stack([summed(column) / trials for column in observed.response.T])
    departure = observed.response.T - mean[:, of_trial]
    off = np.zeros(len(of_trial))
    slope: Term = np.zeros(size)
    with pm.Model() as model:
        plain = _Plain(observed, centred=centred)
        beta = plain.locations()
        shared, variance_u = plain.effects(plain.stretch())
        residual = mean - beta[:, cell] - shared[:, subject, cell]
        if observed.covariate is not None:
            slope = plain.normal("slope", plain.priors.covariate_sd)
            mean_covariate = summed(observed.covariate) / trials
            residual = residual - slope[:, None] * mean_covariate
            off = observed.covariate - mean_covariate[of_trial]
        sigma = plain.sds("")
        pm.Deterministic("spread", pm.math.sqrt(variance_u + sigma**2))
        covariance = _covariance(sigma[:, cell], plain.correlation("rho_w"))
        if trials.max() > 1:
            sigma_e = plain.sds("_e")[:, cell]
            if observed.own_trial_sds:
                omega_s = plain.half("omega_s", plain.priors.omega_s_scale)
                phi = omega_s[:, None] * plain.normal("z_phi", 1.0, observed.subjects)
                sigma_e = sigma_e * pm.math.exp(phi)[:, subject]
            within = _covariance(sigma_e, plain.correlation("rho_e"))
            squares = {}
            for p, q in within:
                # Of departures from which the slopes are taken.
                products = summed(departure[p] * departure[q])
                products = products - slope[p] * summed(off * departure[q])
                products = products - slope[q] * summed(off * departure[p])
                squares[p, q] = products + slope[p] * slope[q] * summed(off * off)
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
