"""Log SDs of all cells at one level, between subjects or between trials, from their coordinates.

For each of P quantities by itself the log SDs of C cells are

    log sigma = m + U h + omega e

    m       prior mean, one number
    U       columns (level, trend over the references, factors) times their prior SDs, (C, K)
    h       coefficients of the columns over their prior SDs, (K,), standard normal
    omega   SD of log sigma about the columns, one number
    e       departures from the columns over omega, (C,), standard normal

The data give log sigma a rough likelihood N(log sigma; l, diag(1/w)), with l and w (C,). Given
omega, log sigma is then normal with some mean and covariance. The coordinates u of log sigma
are standard normal under this law, so that they are nearly so under the posterior. Neither a
centred nor a non-centred form is that for all data. The rough likelihood shapes the coordinates
alone: the Jacobian is included, so that the prior is exact. Given omega, prior and rough likelihood
give in turn

    s = 1 + w omega²                      precision of e given h, (C,)
    q = w / s                             weight of l about the columns, (C,)
    LL' = I + U' diag(q) U                precision of h, (K, K)
    G = diag(s)^(-1/2) U L'^(-1)          (C, K)
    V = diag(s)^(-1/2) (omega² I + G G') diag(s)^(-1/2)

with V the covariance. With B = G'G and FF' = omega² I + B, a root of its middle is

    omega I + G (F + omega I)^(-1) G'

and the map from u is, with nothing divided by an omega that may be tiny,

    y = (F + omega I)^(-1) G'u
    h = L'^(-1) (L^(-1) U' diag(q) (l - m) + y)
    e = omega q (l - m - U h) + u / √s

This h is one of many that give the same log sigma. The prior density is that of log sigma, with the
coefficients integrated out. They have coordinates of their own, standard normal, and take their
exact law given log sigma and omega, of which the data say nothing more.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from percept.inference.model.blocks import (
    add_to_diagonal,
    log_diagonal,
    lower_factor,
    solve_lower,
    solve_upper,
)
from percept.inference.model.design import LEVEL, TREND, Design, columns_of
from percept.inference.model.priors import Priors
from percept.inference.model.statistics import Statistics

Array = NDArray[np.float64]

_LOG_2PI = math.log(2.0 * math.pi)
#: Least share of a scatter that is taken for sigma's: where noise explains all but this, what it
#: leaves is chance. Studies whose subjects differ less than their trials take as many draws with it
#: as with the mode of all cells together, and coordinates stay near.
_LEAST_SHARE = 0.2
#: Least degrees of freedom, of all subjects in a cell, that are more than rounding.
_LEAST_DF = 1e-9


def numbered(name: str, count: int) -> list[str]:
    """Names of the columns of a term: numbered where there are several."""
    if count == 1:
        return [name]
    return [f"{name}:{k + 1}" for k in range(count)]


@dataclasses.dataclass(frozen=True, eq=False)
class LogSpreads:
    """Log SDs at W sets of coordinates, and what they are made of."""

    log_sigma: Array  # (P, C, W)
    multiples: Array  # (P, k, W) Coefficients of all k columns over their prior SDs
    log_density: Array  # (W,) Of the coordinates u under the prior; zero without departures


class CellSpreads:
    """Map from coordinates to the log SDs of P quantities in C cells.

    Parameters
    ----------
    statistics : Statistics
        What the rough likelihood of the SDs is taken from.
    design : Design
        Its columns of log sigma, k in all.
    priors : Priors
        Prior scales.
    suffix : str
        Of names: "" between subjects, "_e" between trials.

    Attributes
    ----------
    coefficients : dict of str to str
        Names of the coefficients of log sigma, one for each column, and of their priors.
    departures : bool
        Whether log SDs scatter about what their columns give.
    centre : float
        Prior mean of log sigma.
    single_sd : float or None
        SD of log sigma in a study of one cell, which has no columns; None where it is estimated.
    rho : str
        Name of the correlation of the level.
    weight : ndarray
        Weights w of the rough likelihood, (P, C): given the columns, a unit of u is 1/√(1 + w
        omega²) of a departure's prior SD.
    """

    def __init__(
        self,
        statistics: Statistics,
        design: Design,
        priors: Priors,
        suffix: str,
    ) -> None:
        terms = design.sd_trial if suffix else design.sd_between
        self.suffix = suffix
        self.rho = f"rho{suffix or '_w'}"
        self.coefficients: dict[str, str] = {}
        names = {LEVEL: f"log_s{suffix}", TREND: f"kappa{suffix}"}
        for term in terms:
            name = names.get(term.name, f"psi{suffix}:{term.name}")
            for coefficient in numbered(name, len(term.columns)):
                self.coefficients[coefficient] = term.prior
        self.departures = not terms or not design.options.common_spread
        log_s_sd = getattr(priors, f"log_s{suffix}_sd")
        self.single_sd = None if terms else log_s_sd
        self.centre = getattr(priors, f"log_s{suffix}_mean")
        x = design.cells.x
        if suffix:
            df = statistics.trial_df
            variance = statistics.trial_squares / np.maximum(df, 1.0)
            rough_mean, self.weight = _rough(variance, 0.0, df)
        else:
            of_subjects = [term for term in design.subject if term.name in names]
            subject_columns = columns_of(of_subjects, x)
            rough_mean, self.weight = _rough_between(statistics, subject_columns)
        loadings = columns_of(terms, x).swapaxes(0, 1)  # (P, K, C) U'
        quantities, count, cells = loadings.shape
        # Turn the columns: U' = rotation diag(sizes) directions. All formulas hold for the turned
        # columns, which are orthogonal, and the turned coefficients rotation'h. Padded with zeros,
        # so that few cells, or no columns, have K = max(k, 1) singular values too.
        width = max(count, 1)
        padded = np.zeros((quantities, width, cells + width))
        padded[:, :count, :cells] = loadings
        rotation, sizes, directions = np.linalg.svd(padded, full_matrices=False)
        self._sizes = sizes[..., None]  # (P, K, 1)
        # A direction without size is arbitrary: it may even point into the padding.
        within = directions[..., :cells]
        self._directions = np.where(self._sizes > 0, within, 0.0)  # (P, K, C)
        self._loadings = self._sizes * self._directions  # (P, K, C) U' turned
        self._columns = self._loadings.swapaxes(1, 2)  # (P, C, K) U turned
        products = self._loadings[:, :, None] * self._loadings[:, None]
        #: (P, K K, C) Times x (P, C, W), these give the entries of U' diag(x) U.
        self._products = products.reshape(quantities, -1, cells)
        #: Rows of the rotation that have coordinates, (P, k, K).
        self._rotated = rotation[:, :count]
        self._rough_departure = (rough_mean - self.centre)[..., None]  # (P, C, 1) l - m

    def __call__(
        self,
        columns: Array,
        cells: Array,
        omega: Array,
        shift: Array | float,
    ) -> LogSpreads:
        """Map coordinates to the spreads of W draws.

        Parameters
        ----------
        columns : ndarray
            Coordinates of the coefficients, (P, k, W), standard normal.
        cells : ndarray
            Coordinates u of log sigma, (P, C, W).
        omega : ndarray
            SDs of log sigma about the columns, (P, W).
        shift : ndarray or float
            What is added to the means l of the rough likelihood, (P, C, W).
        """
        rough_departure = self._rough_departure + shift
        each_cell = omega[:, None]
        variance = omega * omega
        rough_weight = self.weight[..., None]
        precision = 1.0 + rough_weight * variance[:, None]  # s
        weight = rough_weight / precision  # q
        scaled_u = cells / np.sqrt(precision)
        factor = lower_factor(add_to_diagonal(self._squares(weight), 1.0))  # L
        size = len(factor)
        right = np.empty((size, size + 2, *omega.shape))
        right[:, :-2] = self._squares(1.0 / precision)
        right[:, -2] = (self._loadings @ scaled_u).swapaxes(0, 1)
        right[:, -1] = (self._loadings @ (weight * rough_departure)).swapaxes(0, 1)
        for_columns = factor[:, :, None]
        whitened = solve_lower(for_columns, right)
        g_u = whitened[:, -2]  # G'u
        b = solve_lower(for_columns, whitened[:, :-2].swapaxes(0, 1))
        # What B adds is positive: rounding may not leave a pivot below omega².
        root = lower_factor(add_to_diagonal(b, variance), least=variance)  # F
        y = solve_lower(add_to_diagonal(root.copy(), omega), g_u)
        whitened_mean = whitened[:, -1]
        h = solve_upper(factor, y + whitened_mean).swapaxes(0, 1)
        about_columns = self._columns @ h  # U h
        unexplained = rough_departure - about_columns
        e = each_cell * weight * unexplained + scaled_u

        # The prior covariance omega² I + UU' of log sigma is omega² I but along K directions.
        e_along = self._directions @ e
        e_across = e - self._directions.swapaxes(1, 2) @ e_along
        along = self._sizes * h + each_cell * e_along
        variance_along = variance[:, None] + self._sizes * self._sizes
        whitened_along = along / variance_along
        squares = np.einsum("pcw,pcw->pw", e_across, e_across)
        squares += np.einsum("pkw,pkw->pw", along, whitened_along)
        # Half of log det V less half of log det(omega² I + UU'): powers of omega cancel.
        log_precision = np.log(precision).sum(axis=1)
        log_variance = np.log(variance_along).sum(axis=1)
        log_density = log_diagonal(root) - 0.5 * (squares + log_precision + log_variance)
        log_density -= 0.5 * _LOG_2PI * cells.shape[1]

        # The turned coefficients are independent given log sigma, with these means and SDs.
        conditional_mean = self._sizes * whitened_along
        conditional_sd = each_cell / np.sqrt(variance_along)
        turned = conditional_mean + conditional_sd * (self._rotated.swapaxes(1, 2) @ columns)
        return LogSpreads(
            log_sigma=self.centre + about_columns + each_cell * e,
            multiples=self._rotated @ turned,
            log_density=log_density.sum(axis=0),
        )

    def without_departures(self, columns: Array) -> LogSpreads:
        """Map coordinates (P, k, W) of the coefficients alone, which are standard normal."""
        turned = self._rotated.swapaxes(1, 2) @ columns
        log_sigma = self.centre + self._columns @ turned
        return LogSpreads(log_sigma, columns, np.zeros(columns.shape[-1]))

    def _squares(self, weight: Array) -> Array:
        """U' diag(x) U, (K, K, P, W), for weights x (P, C, W)."""
        quantities, count, _ = self._loadings.shape
        flat = self._products @ weight
        by_quantity = flat.reshape(quantities, count, count, -1)
        return by_quantity.transpose(1, 2, 0, 3)


def _rough(
    variance: Array,
    noise: Array | float,
    df: Array,
) -> tuple[Array, Array]:
    """Mean and weight of the rough likelihood of log SDs, each (P, C).

    A scatter, a variance of df degrees of freedom, has the mean sigma² + noise. A log SD is known
    to 1/√(2 df) from a scatter that is all sigma's, and the less the more noise there is. A scatter
    of zero is no evidence of a small SD.
    """
    informed = variance > 0.0
    remaining = np.maximum(variance - noise, _LEAST_SHARE * variance)
    share = np.divide(remaining, variance, out=np.zeros_like(variance), where=informed)
    log_sd = 0.5 * np.log(np.where(informed, remaining, 1.0))
    return log_sd, 2.0 * df * share * share


def _rough_between(statistics: Statistics, subject_columns: Array) -> tuple[Array, Array]:
    """Rough likelihood of the log SDs between subjects.

    Their scatter is less what trials explain, and what subjects' coefficients of their own columns
    (q, P, C) do.
    """
    variance = np.square(statistics.sd)
    df = statistics.df
    if len(subject_columns):
        within, df_within = _within_subjects(statistics, subject_columns)
        smaller = (within > 0.0) & (within < variance)
        variance = np.where(smaller, within, variance)
        df = np.where(smaller, df_within, df)
    return _rough(variance, _noise_of_trials(statistics), df)


def _within_subjects(statistics: Statistics, subject_columns: Array) -> tuple[Array, Array]:
    """Variance of subjects' cell means about the cells and about subjects' lines, and its df.

    Each subject has a coefficient of every column (q, P, C). Fitting it takes degrees of freedom
    from the cells on which the fit leans. The mean of a cell takes one from its subjects.
    """
    cell_means = statistics.cell_means
    about_cells = cell_means - np.nanmean(cell_means, axis=0)
    squares = np.zeros(cell_means.shape[1:])
    df = np.zeros_like(squares)
    for pattern in statistics.patterns:
        cells = pattern.environments
        of_members = about_cells[pattern.members][:, :, cells]
        for p, values in enumerate(of_members.swapaxes(0, 1)):
            columns = subject_columns[:, p, cells]
            fitted = np.linalg.pinv(columns) @ columns
            residuals = values - values @ fitted
            squares[p, cells] += np.square(residuals).sum(axis=0)
            df[p, cells] += pattern.subjects * (1.0 - np.diag(fitted))
    df *= 1.0 - 1.0 / (statistics.df + 1.0)
    # A subject with as many columns as cells has no scatter left, but for rounding.
    df[df < _LEAST_DF] = 0.0
    zeros = np.zeros_like(df)
    return np.divide(squares, df, out=zeros, where=df > 0), df


def _noise_of_trials(statistics: Statistics) -> Array:
    """Variance that trials give to a cell's mean, averaged over the subjects of the cell."""
    df = statistics.trial_df
    squares = statistics.trial_squares
    all_squares = squares.sum(axis=1, keepdims=True)
    # An environment without repeats takes the variance that the others have together.
    pooled = all_squares / max(df.sum(), 1.0)
    by_cell = squares / np.maximum(df, 1.0)
    variance = np.where(df > 0, by_cell, pooled)
    inverse_trials = np.zeros(df.size)
    for pattern in statistics.patterns:
        inverse_trials[pattern.environments] += pattern.subjects / pattern.trials
    return variance * inverse_trials / (statistics.df + 1.0)
