"""The hierarchical model run forwards: a design, true values, responses, a table.

    y_ijr = β_j + u_i + g_i x_j + w_ij + e_ijr
    β_jp = α_p + γ_p x_jp + δ_jp          δ_jp ~ N(0, τ_p²)
    log σ_jp ~ N(log s_p + κ_p x_jp, ω_p²)

Subjects may have trial SDs of their own: σ_e times exp(φ_ip), with φ_ip ~ N(0, ω_s,p²).

Each of three steps has its own record, so that a calibration can hold any of them fixed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError
from percept.inference.model.design import shows_subject_trends
from percept.inference.model.priors import Priors

#: What the column `source` of every simulated table says.
SOURCE = "simulated"
#: Parameters of a design by default: stiffness and damping.
PARAMETERS = ("k", "b")
Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Numbers = Array | float


class Rows(NamedTuple):
    """The N trials of a design, ordered by subject, environment and number; (N,) each."""

    subject: Indices  # index
    environment: Indices  # index
    trial: Indices  # number within its cell, from 1


@dataclass(frozen=True, eq=False)
class Design:
    """Who adjusts what, and how often."""

    references: Array  # (J, P) positive, in the order of `parameters` and their units
    trials: Indices  # (I, J) trials of each subject in each environment, 0 for an empty cell
    parameters: tuple[str, ...] = PARAMETERS
    environments: tuple[str, ...] = ()  # (J,) names; VE1, VE2, … when empty

    def __post_init__(self) -> None:
        references = np.array(self.references, dtype=float)
        usable = np.isfinite(references) & (references > 0)
        if not usable.all():
            message = "every reference must be positive: responses are ratios to it."
            raise UsageError(message, key="references", value=float(references[~usable][0]))
        names = self.environments or tuple(f"VE{j}" for j in range(1, len(references) + 1))
        object.__setattr__(self, "references", references)
        object.__setattr__(self, "environments", names)

    @classmethod
    def balanced(
        cls,
        references: ArrayLike,
        *,
        subjects: int,
        trials: int = 1,
        parameters: tuple[str, ...] = PARAMETERS,
        environments: tuple[str, ...] = (),
    ) -> Design:
        """Let every subject meet every environment equally often.

        Parameters
        ----------
        references : array_like, shape (J, P)
            Positive, in the units of the parameters.
        subjects, trials : int
            Subjects, and trials of each in each environment.
        parameters, environments : tuple of str
            Names; of environments VE1, VE2, … by default.

        Returns
        -------
        Design
        """
        table = np.asarray(references, dtype=float)
        return cls(table, np.full((subjects, len(table)), trials), parameters, environments)

    @property
    def subjects(self) -> tuple[str, ...]:
        """Names of the subjects: S01, S02 …, zero-padded so that they sort."""
        width = max(2, len(str(len(self.trials))))
        return tuple(f"S{i:0{width}d}" for i in range(1, len(self.trials) + 1))

    def rows(self) -> Rows:
        """Return who makes which trial where."""
        counts = self.trials.ravel()
        cell = np.repeat(np.arange(counts.size), counts)
        # Number of the first trial of each trial's cell.
        first = np.repeat(np.cumsum(counts) - counts, counts)
        subject, environment = np.divmod(cell, self.trials.shape[1])
        return Rows(subject, environment, np.arange(cell.size) - first + 1)

    @property
    def decades(self) -> NDArray[np.float64]:
        """x_jp = log10(reference / geometric mean of the references), (J, P), in decades."""
        logs = np.log10(self.references)
        return logs - logs.mean(axis=0)

    @property
    def shows_subject_trends(self) -> bool:
        """Whether some subject meets three references."""
        return shows_subject_trends(self.trials > 0, self.decades.T)

    @property
    def repeated(self) -> bool:
        """Whether any cell holds more than one trial, so that trial scatter can be told apart."""
        return bool(self.trials.max() > 1)


@dataclass(frozen=True, eq=False)
class Hyperparameters:
    """What all environments share, on the model's unit-free scale; arrays are (P,).

    By default there is no bias, no scatter and no correlation.
    """

    alpha: Numbers = 0.0  # Level of the points of equality
    gamma: Numbers = 0.0  # Their slope per decade
    tau: Numbers = 0.0  # SD of an environment's own shift δ
    sigma_u: Numbers = 0.0  # SD of the subject effect u
    rho_u: float = 0.0  # Correlation of two parameters in u
    s: Numbers = 0.0  # Typical SD between subjects within an environment
    kappa: Numbers = 0.0  # Slope of log σ per decade; 0 is Weber's law
    omega: Numbers = 0.0  # SD of log σ about that line
    rho_w: float = 0.0  # Correlation of two parameters in w
    s_e: Numbers = 0.0  # The same four for the scatter between trials; zero where there is none
    kappa_e: Numbers = 0.0
    omega_e: Numbers = 0.0
    rho_e: float = 0.0
    omega_s: Numbers = 0.0  # SD of the log of a subject's trial SD over its typical size
    sigma_trend: Numbers = 0.0  # SD of a subject's own trend per decade
    rho_trend: float = 0.0  # Correlation of two parameters in it


@dataclass(frozen=True, eq=False)
class TrueValues:
    """The state of the world one study is drawn from, on the model's unit-free scale."""

    hyper: Hyperparameters
    beta: Array  # (J, P) an environment's point of equality α + γx + δ
    sigma: Array  # (J, P) SD between subjects within an environment
    sigma_e: Array  # (J, P) SD between trials, of a typical subject where they differ

    def cov_users(self, decades: Array) -> Array:
        """Σ_u + x x'Σ_g + Σ_w, (J, P, P), of users at references of so many decades x, (J, P)."""
        hyper = self.hyper
        own = _covariance(self.sigma, hyper.rho_w)
        trends = _covariance(decades * hyper.sigma_trend, hyper.rho_trend)
        shared = np.broadcast_to(hyper.sigma_u, decades.shape)
        return own + trends + _covariance(shared, hyper.rho_u)

    @property
    def cov_e(self) -> Array:
        """Σ_e,j, (J, P, P); zero where the study has no trial level."""
        return _covariance(self.sigma_e, self.hyper.rho_e)


def correlated_normal(rng: np.random.Generator, shape: tuple[int, ...], rho: float) -> Array:
    """Draw standard normals whose last axis, of length 1 or 2, has a correlation.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws.
    shape : tuple of int
        Of the result.
    rho : float
        Correlation of the two, within [-1, 1].

    Returns
    -------
    ndarray
    """
    z = rng.standard_normal(shape)
    if shape[-1] == 2:
        # (1 - rho)(1 + rho) keeps the digits that 1 - rho**2 loses near ±1.
        z[..., 1] = rho * z[..., 0] + np.sqrt((1 - rho) * (1 + rho)) * z[..., 1]
    return z


def draw_hyperparameters(
    design: Design, priors: Priors, rng: np.random.Generator
) -> Hyperparameters:
    """Draw what the environments share from its prior; levels the design cannot show are zero.

    Parameters
    ----------
    design : Design
        One environment shows no scatter between environments, one trial none between trials.
    priors : Priors
        The priors.
    rng : numpy.random.Generator
        Draws. Zero levels are drawn too, so that a seed means the same for every design.

    Returns
    -------
    Hyperparameters
    """
    count = len(design.parameters)
    several = float(len(design.environments) > 1)
    repeats = float(design.repeated)
    trends = float(design.shows_subject_trends)
    pair = float(count == 2)

    def normal(sd: float, mean: float = 0.0) -> Array:
        return rng.normal(mean, sd, count)

    def correlation() -> float:
        return 2 * rng.beta(priors.rho_shape, priors.rho_shape) - 1

    return Hyperparameters(
        alpha=normal(priors.alpha_sd),
        gamma=several * normal(priors.gamma_sd),
        tau=several * abs(normal(priors.tau_scale)),
        sigma_u=several * abs(normal(priors.sigma_u_scale)),
        rho_u=several * pair * correlation(),
        s=np.exp(normal(priors.log_s_sd, priors.log_s_mean)),
        kappa=several * normal(priors.kappa_sd),
        omega=several * abs(normal(priors.omega_scale)),
        rho_w=pair * correlation(),
        s_e=repeats * np.exp(normal(priors.log_s_e_sd, priors.log_s_e_mean)),
        kappa_e=repeats * several * normal(priors.kappa_e_sd),
        omega_e=repeats * several * abs(normal(priors.omega_e_scale)),
        rho_e=repeats * pair * correlation(),
        sigma_trend=trends * abs(normal(priors.sigma_trend_scale)),
        rho_trend=trends * pair * correlation(),
    )


def draw_environments(
    hyper: Hyperparameters, design: Design, rng: np.random.Generator
) -> TrueValues:
    """Draw each environment's shift δ and its SDs σ and σ_e, given what the environments share.

    Parameters
    ----------
    hyper : Hyperparameters
        What they share.
    design : Design
        The references.
    rng : numpy.random.Generator
        Draws.

    Returns
    -------
    TrueValues
    """
    x = design.decades
    delta = hyper.tau * rng.standard_normal(x.shape)

    def scales(s: Numbers, kappa: Numbers, omega: Numbers) -> Array:
        return s * np.exp(kappa * x + omega * rng.standard_normal(x.shape))

    return TrueValues(
        hyper=hyper,
        beta=hyper.alpha + hyper.gamma * x + delta,
        sigma=scales(hyper.s, hyper.kappa, hyper.omega),
        sigma_e=scales(hyper.s_e, hyper.kappa_e, hyper.omega_e),
    )


def draw_responses(values: TrueValues, design: Design, rng: np.random.Generator) -> Array:
    """Draw the subjects and their trials, y = β_j + u_i + g_i x_j + w_ij + e_ijr.

    Parameters
    ----------
    values : TrueValues
        The true values.
    design : Design
        Who adjusts what.
    rng : numpy.random.Generator
        Draws.

    Returns
    -------
    ndarray, shape (N, P)
        The trials in the order of `Design.rows`, on the model's scale.
    """
    subjects, environments = design.trials.shape
    parameters = len(design.parameters)
    hyper = values.hyper
    u = hyper.sigma_u * correlated_normal(rng, (subjects, parameters), hyper.rho_u)
    # Drawn for empty cells too.
    w = values.sigma * correlated_normal(rng, (subjects, environments, parameters), hyper.rho_w)
    subject, environment, _ = design.rows()
    trial_sd = values.sigma_e[environment]
    if np.any(hyper.omega_s):
        ratios = np.exp(hyper.omega_s * rng.standard_normal((subjects, parameters)))
        trial_sd = trial_sd * ratios[subject]
    e = trial_sd * correlated_normal(rng, (subject.size, parameters), hyper.rho_e)
    of_subjects = u[:, None] + w
    if np.any(hyper.sigma_trend):
        trends = hyper.sigma_trend * correlated_normal(rng, u.shape, hyper.rho_trend)
        of_subjects += trends[:, None] * design.decades
    return values.beta[environment] + of_subjects[subject, environment] + e


def simulate(
    values: TrueValues,
    design: Design,
    rng: np.random.Generator,
    *,
    family: Literal["lognormal", "normal"] = "lognormal",
) -> pd.DataFrame:
    """Draw the sessions of a study: the adjusted value is reference·exp(y), or reference·(1 + y).

    Parameters
    ----------
    values : TrueValues
        The true values.
    design : Design
        Who adjusts what.
    rng : numpy.random.Generator
        Draws.
    family : {"lognormal", "normal"}
        Distribution of the users.

    Returns
    -------
    DataFrame
        As `session_table` gives it.

    Raises
    ------
    RefusalError
        A response leaves the range of doubles.
    """
    y = draw_responses(values, design, rng)
    with np.errstate(over="ignore", under="ignore"):
        ratio = np.exp(y) if family == "lognormal" else 1 + y
        adjusted = design.references[design.rows().environment] * ratio
    lost = ~np.isfinite(adjusted)
    if family == "lognormal":
        lost |= adjusted <= 0
    if lost.any():
        message = "a drawn response leaves the range of doubles."
        raise RefusalError(message, value=float(y[lost][0]), hint="Use another seed.")
    return session_table(design, adjusted)


def session_table(design: Design, adjusted: Array) -> pd.DataFrame:
    """Put N trials into a tidy table.

    Parameters
    ----------
    design : Design
        Names and references.
    adjusted : ndarray, shape (N, P)
        Adjusted values in the order of `Design.rows`, in the units of the parameters.

    Returns
    -------
    DataFrame
        The columns of a session file, and `source`.
    """
    subject, environment, trial = design.rows()
    columns: dict[str, object] = {
        "subject": np.array(design.subjects, dtype=object)[subject],
        "session": "1",
        "environment": np.array(design.environments, dtype=object)[environment],
    }
    for p, name in enumerate(design.parameters):
        columns[f"{name}_ref"] = design.references[environment, p]
    columns["trial"] = trial
    for p, name in enumerate(design.parameters):
        columns[f"{name}_adj"] = adjusted[:, p]
    columns["source"] = SOURCE
    return pd.DataFrame(columns)


def _covariance(sd: Array, rho: float) -> Array:
    correlation = np.full((sd.shape[-1], sd.shape[-1]), rho)
    np.fill_diagonal(correlation, 1.0)
    return sd[..., :, None] * correlation * sd[..., None, :]
