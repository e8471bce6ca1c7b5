"""The model once more, written plainly: covariances over all trials, for many draws at once.

Nothing here comes from percept but the records of a study. Arrays have W draws first, then P
quantities, C cells and M trials; flat ones stand quantity by quantity.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping

import numpy as np
from scipy import stats

Array = np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """Trials, and the cells that they were made in; a cell may have none."""

    response: Array  # (M, P)
    subject: Array  # (M,)
    cell: Array  # (M,)
    environment: Array  # (C,)
    x: Array  # (P, C) Decades of the references
    levels: Mapping[str, tuple[int, Array]] = dataclasses.field(default_factory=dict)
    terms: tuple[tuple[str, ...], ...] = ()
    between: tuple[str, ...] = ()
    spread: tuple[str, ...] = ()
    slopes: bool = False
    covariates: Array | None = None  # (M, covariates) Centred, within subjects if they vary there
    own_slopes: Mapping[str, int] = dataclasses.field(default_factory=dict)  # Numbers of covariates
    resolution: tuple[float, float] = (0.0, 0.0)  # Variances added to cell means and to trials

    def columns(self) -> dict[str, Array]:
        """Columns (K, P, C) of every term."""
        found = {"level": np.ones_like(self.x)[None]}
        if len(np.unique(self.environment)) > 1:
            found["trend"] = self.x[None]
        for names in self.terms:
            factors = []
            for name in names:
                count, level = self.levels[name]
                factors.append(contrasts(count)[:, level])
            products = [np.prod(row, axis=0) for row in itertools.product(*factors)]
            every = np.stack(products)[:, None]
            found[":".join(names)] = np.broadcast_to(every, (len(every), *self.x.shape))
        return found


def contrasts(levels: int) -> Array:
    """Orthogonal columns (levels - 1, levels) that sum to zero, of length √½."""
    rows = np.zeros((levels - 1, levels))
    for k in range(1, levels):
        rows[k - 1, :k] = -1.0
        rows[k - 1, k] = k
    return rows / np.sqrt(2.0 * np.square(rows).sum(axis=1, keepdims=True))


class Twin:
    """All covariances of a study at W sets of named scales, as `Model.scales` gives them."""

    def __init__(self, study: Study, priors, scales) -> None:
        self.study = study
        self.priors = priors
        self.named = {name: values for name, (_, values) in scales.items()}
        self.size, self.cells = study.x.shape
        self.width = len(self.named["sigma"])
        self.covariates = np.zeros((len(study.cell), 0))
        if study.covariates is not None:
            self.covariates = study.covariates
        self.locations = self._locations()
        self.users = self._users()
        self.observed = self._observed()

    def _covariance(self, sd: Array, rho: str) -> Array:
        """Covariances (W, P, P) of SDs (W, P)."""
        matrix = sd[:, :, None] * sd[:, None]
        if rho in self.named:
            off = 1.0 - np.eye(self.size)
            matrix = matrix * (np.eye(self.size) + off * self.named[rho][:, None, None])
        return matrix

    def _locations(self) -> Array:
        """Prior covariance of cells' locations and then slopes, (W, R, R)."""
        study = self.study
        same = study.environment[:, None] == study.environment
        sds = {"level": self.priors.alpha_sd, "trend": self.priors.gamma_sd}
        total = np.zeros((self.width, self.size, self.cells, self.size, self.cells))
        for name, columns in study.columns().items():
            products = np.einsum("kpc,kpd->pcd", columns, columns)
            tau = self.named.get("tau" if name == "level" else f"tau:{name}")
            for p in range(self.size):
                total[:, p, :, p] += sds.get(name, self.priors.lambda_sd) ** 2 * products[p]
                if tau is not None:
                    total[:, p, :, p] += tau[:, p, None, None] ** 2 * same * products[p]
        flat = total.reshape(self.width, self.size * self.cells, -1)
        slopes = self.covariates.shape[1] * self.size
        whole = np.zeros((self.width, flat.shape[1] + slopes, flat.shape[1] + slopes))
        whole[:, : flat.shape[1], : flat.shape[1]] = flat
        diagonal = np.arange(flat.shape[1], whole.shape[1])
        whole[:, diagonal, diagonal] = self.priors.covariate_sd**2
        return whole

    def _users(self) -> Array:
        """Covariance of one user's cells about the locations, (W, P C, P C)."""
        study = self.study
        columns = study.columns()
        log_size = np.zeros((self.width, *study.x.shape))
        for name in study.spread:
            log_size += np.einsum("kpc,wpk->wpc", columns[name], self.named[f"eta:{name}"])
        total = np.zeros((self.width, self.size, self.cells, self.size, self.cells))
        for name, of_term in columns.items():
            suffix = "u" if name == "level" else f"v:{name}"
            if f"sigma_{suffix}" not in self.named:
                continue
            covariance = self._covariance(self.named[f"sigma_{suffix}"], f"rho_{suffix}")
            sized = of_term * np.exp(log_size)[:, None]
            total += np.einsum("wkpc,wkqd,wpq->wpcqd", sized, sized, covariance)
        for c in range(self.cells):
            sigma = self.named["sigma"][:, :, c]
            total[:, :, c, :, c] += self._covariance(sigma, "rho_w")
        return total.reshape(self.width, self.size * self.cells, -1)

    def _observed(self) -> Array:
        """Covariance of all trials, (W, P M, P M)."""
        study = self.study
        trials = len(study.cell)
        at = (np.arange(self.size)[:, None] * self.cells + study.cell).ravel()
        by_subject = study.subject[:, None] == study.subject
        same_cell = by_subject & (study.cell[:, None] == study.cell)
        total = self.loadings @ self.locations @ self.loadings.T
        total += np.tile(by_subject, (self.size, self.size)) * self.users[:, at[:, None], at]
        by_quantity = total.reshape(self.width, self.size, trials, self.size, trials)
        for name, number in study.own_slopes.items():
            slopes = self._covariance(self.named[f"sigma_v:{name}"], f"rho_v:{name}")
            values = by_subject * np.outer(*[self.covariates[:, number]] * 2)
            by_quantity += np.einsum("wpq,mn->wpmqn", slopes, values)
        for p, q in itertools.product(range(self.size), repeat=2):
            if p == q:
                by_quantity[:, p, :, p] += study.resolution[0] * same_cell
                by_quantity[:, p, :, p] += study.resolution[1] * np.eye(trials)
            if "sigma_e" in self.named:
                sd = self.named["sigma_e"][:, :, study.cell]
                if "phi" in self.named:
                    sd = sd * np.exp(self.named["phi"][:, :, study.subject])
                rho = np.ones(self.width) if p == q else self.named["rho_e"]
                variance = rho[:, None] * sd[:, p] * sd[:, q]
                by_quantity[:, p, :, q] += variance[:, :, None] * np.eye(trials)
        return total

    @property
    def loadings(self) -> Array:
        """Locations' part in every trial, (P M, R)."""
        trials = len(self.study.cell)
        count = self.covariates.shape[1]
        whole = np.zeros((self.size, trials, self.size * (self.cells + count)))
        for p in range(self.size):
            whole[p, np.arange(trials), p * self.cells + self.study.cell] = 1.0
            first = self.size * self.cells + p
            whole[p, :, first :: self.size][:, :count] = self.covariates
        return whole.reshape(self.size * trials, -1)

    def log_likelihood(self, kept: Array | slice = slice(None)) -> Array:
        """Log density of the trials, or of some of them, (W,)."""
        every = np.arange(len(self.study.cell))[kept]
        at = (np.arange(self.size)[:, None] * len(self.study.cell) + every).ravel()
        response = self.study.response.T.ravel()[at]
        lower = np.linalg.cholesky(self.observed[:, at[:, None], at])
        white = np.linalg.solve(lower, np.broadcast_to(response[:, None], (*lower.shape[:2], 1)))
        log_diagonal = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        constant = 0.5 * np.log(2.0 * np.pi) * len(at)
        return -0.5 * np.square(white[..., 0]).sum(axis=1) - log_diagonal - constant

    def posterior(self) -> tuple[Array, Array]:
        """Mean (W, R) and covariance (W, R, R) of the locations given the trials."""
        towards = self.loadings @ self.locations
        gain = np.linalg.solve(self.observed, towards).swapaxes(1, 2)
        return gain @ self.study.response.T.ravel(), self.locations - gain @ towards

    def log_prior(self) -> Array:
        """Log density of the natural variables, (W,): log SDs of cells, and all other scales."""
        priors = self.priors
        half_normal = {"omega": priors.omega_scale, "omega_e": priors.omega_e_scale}
        half_normal["omega_s"] = priors.omega_s_scale
        half_normal["sigma_v:trend"] = priors.sigma_trend_scale
        total = np.zeros(self.width)
        for name, values in self.named.items():
            if name.startswith("rho"):
                total += stats.beta.logpdf((values + 1) / 2, priors.rho_shape, priors.rho_shape)
                total -= np.log(2)
            elif name in half_normal or name.startswith(("tau", "sigma_u", "sigma_v")):
                scale = priors.sigma_u_scale if name.startswith("sigma") else priors.tau_scale
                density = stats.halfnorm.logpdf(values, scale=half_normal.get(name, scale))
                total += density.sum(axis=1)
            elif name.startswith("eta"):
                total += stats.norm.logpdf(values, 0.0, priors.psi_sd).sum(axis=(1, 2))
            elif name == "phi":
                omega = self.named["omega_s"][..., None]
                total += stats.norm.logpdf(values, 0.0, omega).sum(axis=(1, 2))
        for suffix in ("", "_e"):
            if f"sigma{suffix}" in self.named:
                total += self._log_prior_of_level(suffix)
        return total

    def _log_prior_of_level(self, suffix: str) -> Array:
        """Log density of log SDs and their coefficients."""
        priors = self.priors
        log_sigma = np.log(self.named[f"sigma{suffix}"])
        mean = getattr(priors, f"log_s{suffix}_mean")
        sd = getattr(priors, f"log_s{suffix}_sd")
        if f"s{suffix}" not in self.named:
            return stats.norm.logpdf(log_sigma, mean, sd).sum(axis=(1, 2))
        log_s = np.log(self.named[f"s{suffix}"])
        total = stats.norm.logpdf(log_s, mean, sd).sum(axis=1)
        centre = np.broadcast_to(log_s[..., None], log_sigma.shape).copy()
        for name, columns in self.study.columns().items():
            for k, column in enumerate(columns):
                number = f":{k + 1}" if len(columns) > 1 else ""
                trend = name == "trend"
                coefficient = f"kappa{suffix}" if trend else f"psi{suffix}:{name}{number}"
                if coefficient in self.named:
                    prior_sd = getattr(priors, f"kappa{suffix}_sd") if trend else priors.psi_sd
                    values = self.named[coefficient]
                    total += stats.norm.logpdf(values, 0.0, prior_sd).sum(axis=1)
                    centre += values[..., None] * column
        if f"omega{suffix}" in self.named:
            omega = self.named[f"omega{suffix}"][..., None]
            total += stats.norm.logpdf(log_sigma, centre, omega).sum(axis=(1, 2))
        return total

    def variables(self) -> Array:
        """The variables of `log_prior`, (W, d)."""
        found = []
        for name, values in self.named.items():
            suffix = name.removeprefix("sigma").removeprefix("s")
            fixed = f"s{suffix}" in self.named and f"omega{suffix}" not in self.named
            if name in ("sigma", "sigma_e") and fixed:
                continue
            logged = name in ("s", "s_e", "sigma", "sigma_e")
            found.append((np.log(values) if logged else values).reshape(self.width, -1))
        return np.hstack(found)
