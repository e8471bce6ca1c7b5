"""The hierarchical model run forwards: from priors to the true values of one study to its responses.

    y_ijr = β_j + u_i + w_ij + e_ijr
    β_jp = α_p + γ_p x_jp + δ_jp          δ_jp ~ N(0, τ_p²)
    log σ_jp ~ N(log s_p + κ_p x_jp, ω_p²)

Three steps, each with its own record, so that a calibration can hold any of them fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.inference.hierarchy.priors import Priors
from percept.simulate.design import Design

Array = NDArray[np.float64]
Seed = int | np.random.SeedSequence | np.random.Generator


@dataclass(frozen=True, eq=False)
class Hyperparameters:
    """What all environments share; arrays are (P,), on the model's unit-free scale.

    Parameters
    ----------
    alpha, gamma : (P,) array
        Level and slope per decade of the points of equality.
    tau : (P,) array
        SD of an environment's own shift δ.
    sigma_u : (P,) array
        SD of the subject effect u.
    rho_u : float
        Correlation of k and b in u.
    s, kappa, omega : (P,) array
        Typical between-subject SD within an environment, its log-slope per decade (0 is Weber's law)
        and the SD of log σ about that line.
    rho_w : float
        Correlation of k and b in w.
    s_e, kappa_e, omega_e : (P,) array
        The same three for the scatter between trials; all zero where there is none.
    rho_e : float
        Correlation of k and b in e.
    """

    alpha: Array
    gamma: Array
    tau: Array
    sigma_u: Array
    rho_u: float
    s: Array
    kappa: Array
    omega: Array
    rho_w: float
    s_e: Array
    kappa_e: Array
    omega_e: Array
    rho_e: float


@dataclass(frozen=True, eq=False)
class TrueValues:
    """The state of the world one study is drawn from, on the model's unit-free scale.

    Parameters
    ----------
    hyper : Hyperparameters
        What the environments share.
    delta, beta : (J, P) array
        An environment's own shift, and its point of equality β = α + γx + δ.
    sigma, sigma_e : (J, P) array
        SD between subjects within an environment, and between trials.
    """

    hyper: Hyperparameters
    delta: Array
    beta: Array
    sigma: Array
    sigma_e: Array

    @property
    def cov_u(self) -> Array:
        """Σ_u, (P, P)."""
        return _covariance(self.hyper.sigma_u, self.hyper.rho_u)

    @property
    def cov_w(self) -> Array:
        """Σ_w,j, (J, P, P)."""
        return _covariance(self.sigma, self.hyper.rho_w)

    @property
    def cov_e(self) -> Array:
        """Σ_e,j, (J, P, P); zero where the study has no trial level."""
        return _covariance(self.sigma_e, self.hyper.rho_e)


@dataclass(frozen=True, eq=False)
class Responses:
    """The N trials of one study on the model's scale, ordered by subject, environment, trial.

    Parameters
    ----------
    subject, environment, trial : (N,) array of int
        Index of the subject and of the environment, from 0; number of the trial, from 1.
    y : (N, P) array
        The responses.
    u : (I, P) array
        Subject effects.
    w : (I, J, P) array
        Effects of a subject in an environment, drawn for empty cells too.
    """

    subject: NDArray[np.int64]
    environment: NDArray[np.int64]
    trial: NDArray[np.int64]
    y: Array
    u: Array
    w: Array


def generator(seed: Seed) -> np.random.Generator:
    """Open the source of randomness that a seed stands for."""
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError) as error:
        raise UsageError("a seed is a whole number, not negative.", key="seed", value=seed) from error


def correlated_normal(rng: np.random.Generator, shape: tuple[int, ...], rho: float) -> Array:
    """Draw standard normals whose last axis, of length 1 or 2, has correlation `rho`."""
    z = rng.standard_normal(shape)
    if shape[-1] == 2:
        # (1 - rho)(1 + rho) keeps the digits that 1 - rho**2 loses near ±1.
        z[..., 1] = rho * z[..., 0] + np.sqrt((1 - rho) * (1 + rho)) * z[..., 1]
    return z


def draw_hyperparameters(design: Design, priors: Priors, rng: np.random.Generator) -> Hyperparameters:
    """Draw what the environments share from its prior.

    With one environment γ, δ, τ, κ, ω and u leave the model, so their values are zero; without repeated
    trials the trial level does; with one parameter there is no correlation.

    Parameters
    ----------
    design : Design
        Says how many parameters there are and which levels the model has.
    priors : Priors
        Scales and centres of the priors.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    Hyperparameters
        One draw.
    """
    count = len(design.parameters)
    several = float(len(design.environments) > 1)
    repeats = float(design.repeated)
    pair = float(count == 2)

    def normal(sd: float) -> Array:
        return sd * rng.standard_normal(count)

    def half_normal(scale: float) -> Array:
        return scale * np.abs(rng.standard_normal(count))

    def correlation() -> float:
        return 2 * rng.beta(priors.rho_shape, priors.rho_shape) - 1

    return Hyperparameters(
        alpha=normal(priors.alpha_sd),
        gamma=several * normal(priors.gamma_sd),
        tau=several * half_normal(priors.tau_scale),
        sigma_u=several * half_normal(priors.sigma_u_scale),
        rho_u=several * pair * correlation(),
        s=np.exp(priors.log_s_mean + normal(priors.log_s_sd)),
        kappa=several * normal(priors.kappa_sd),
        omega=several * half_normal(priors.omega_scale),
        rho_w=pair * correlation(),
        s_e=repeats * np.exp(priors.log_s_e_mean + normal(priors.log_s_e_sd)),
        kappa_e=repeats * several * normal(priors.kappa_e_sd),
        omega_e=repeats * several * half_normal(priors.omega_e_scale),
        rho_e=repeats * pair * correlation(),
    )


def draw_environments(hyper: Hyperparameters, design: Design, rng: np.random.Generator) -> TrueValues:
    """Draw each environment's shift δ and its SDs σ and σ_e, given what the environments share.

    Parameters
    ----------
    hyper : Hyperparameters
        What the environments share.
    design : Design
        Gives x, the references in decades about their geometric mean.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    TrueValues
        One draw.
    """
    x = design.decades
    delta = hyper.tau * rng.standard_normal(x.shape)

    def scales(s: Array, kappa: Array, omega: Array) -> Array:
        return s * np.exp(kappa * x + omega * rng.standard_normal(x.shape))

    return TrueValues(
        hyper=hyper,
        delta=delta,
        beta=hyper.alpha + hyper.gamma * x + delta,
        sigma=scales(hyper.s, hyper.kappa, hyper.omega),
        sigma_e=scales(hyper.s_e, hyper.kappa_e, hyper.omega_e),
    )


def draw_responses(values: TrueValues, design: Design, rng: np.random.Generator) -> Responses:
    """Draw the subjects and their trials, given the true values.

    Parameters
    ----------
    values : TrueValues
        What is true of the environments.
    design : Design
        Trials per cell.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    Responses
        y = β_j + u_i + w_ij + e_ijr for every trial of the design.
    """
    counts = design.trials
    subjects, environments = counts.shape
    parameters = len(design.parameters)
    hyper = values.hyper
    u = hyper.sigma_u * correlated_normal(rng, (subjects, parameters), hyper.rho_u)
    w = values.sigma * correlated_normal(rng, (subjects, environments, parameters), hyper.rho_w)
    cell = np.repeat(np.arange(counts.size), counts.ravel())
    i, j = np.divmod(cell, environments)
    first = np.repeat(np.cumsum(counts.ravel()) - counts.ravel(), counts.ravel())
    e = values.sigma_e[j] * correlated_normal(rng, (cell.size, parameters), hyper.rho_e)
    return Responses(
        subject=i,
        environment=j,
        trial=np.arange(cell.size) - first + 1,
        y=values.beta[j] + u[i] + w[i, j] + e,
        u=u,
        w=w,
    )


def _covariance(sd: Array, rho: float) -> Array:
    correlation = np.full((sd.shape[-1], sd.shape[-1]), rho)
    np.fill_diagonal(correlation, 1.0)
    return sd[..., :, None] * correlation * sd[..., None, :]
