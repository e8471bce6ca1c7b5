"""The model of one quantity under two conditions that the same subjects went through, by dense algebra.

Cells are references at a level, c = -1/2 at the first and 1/2 at the second:

    y = alpha + gamma x_j + delta_j + c (lambda + zeta_j) + u_i + c v_i + w + e

with delta ~ N(0, tau²), zeta ~ N(0, tau_c²), u ~ N(0, sigma_u²) and v ~ N(0, sigma_v²). The SDs of
w and e are each cell's own: log sigma = log s + kappa x_j + c psi + omega z. Without v the interval
of the overall contrast is too narrow. All that is linear is integrated out.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.blocks import cholesky
from percept.inference.hierarchy.density import ConditionalMoments, Model
from percept.inference.hierarchy.priors import LIMIT, Named, Priors, draws_first, half_normal
from percept.inference.hierarchy.statistics import Statistics

__all__ = ["Spread", "WithinSubjects"]

Array = NDArray[np.float64]
_PASS = 1024  # Draws worked on at a time
_LOG_2PI = float(np.log(2.0 * np.pi))


class Spread:
    """Log SDs of one level: centre + G z, G = [loadings, omega I] and z standard normal.

    Coordinates follow the law of z given a rough likelihood N(log sigma; rough, 1/weight) of the
    data. It shapes the coordinates alone: their density gives the prior its due.
    """

    def __init__(self, centre: float, loadings: Array, rough: Array, weight: Array) -> None:
        self.centre, self._loadings, self._rough, self._weight = centre, loadings, rough, weight
        self.count = sum(loadings.shape)  # Of coordinates

    def rows(self, omega: Array) -> Array:
        """Return G for every omega (W,), shape (W, M, count)."""
        own = omega[:, None, None] * np.eye(len(self._rough))
        return np.concatenate(
            [np.broadcast_to(self._loadings, (len(omega), *self._loadings.shape)), own], 2
        )

    def multiples(self, u: Array, omega: Array) -> tuple[Array, Array]:
        """Return z at coordinates u (W, count), and the log density of u."""
        weighed = np.swapaxes(self.rows(omega), 1, 2) * self._weight
        precision = np.eye(self.count) + weighed @ self.rows(omega)
        factor = cholesky(precision)
        middle = _solve(precision, weighed @ (self._rough - self.centre)[:, None])
        z = (middle + _solve(np.swapaxes(factor, 1, 2), u[..., None]))[..., 0]
        value = -0.5 * ((z**2).sum(axis=1) + _LOG_2PI * self.count) - np.log(_diagonal(factor)).sum(
            axis=1
        )
        return z, value

    def __call__(self, u: Array, omega: Array) -> tuple[Array, Array]:
        """Log SDs (W, M) at coordinates given omega (W,), and the log density of the coordinates."""
        z, value = self.multiples(u, omega)
        return self.centre + (self.rows(omega) @ z[..., None])[..., 0], value


@dataclasses.dataclass(frozen=True, eq=False)
class _Locations:
    """Law of the M cell means given scales: rows @ z, z ~ N(mean, (factor factor')⁻¹)."""

    rows: Array  # (W, M, Q)
    mean: Array  # (W, Q)
    factor: Array  # (W, Q, Q)
    log_density: Array  # (W,) Of the cell means, locations integrated out


class WithinSubjects(Model):
    """Contrasts of one quantity between two levels, at each of J references and on their average."""

    def __init__(
        self,
        statistics: Statistics,
        reference: NDArray[np.intp],
        second: NDArray[np.bool_],
        *,
        names: tuple[str, ...],
        priors: Priors | None = None,
    ) -> None:
        """Take statistics of M cells, each the `reference` of J named ones at the first or second level."""
        self.statistics, self._priors = statistics, priors or Priors()
        self.priors_in_force = dataclasses.asdict(self._priors)
        self._references, self.reference = names, reference
        self._c, self._x = np.where(second, 0.5, -0.5), statistics.x[0]
        self._at = (reference[:, None] == np.arange(len(names))).astype(float)
        self.cells = tuple((statistics.parameters[0], name) for name in (*names, "overall"))
        # What each contrast, and then the average of all, is of the cell means.
        each = (self._at * (2.0 * self._c)[:, None]).T
        self._contrast = np.vstack([each, each.mean(axis=0)])
        p, loads = self._priors, np.stack([np.ones_like(self._x), self._x, self._c], axis=1)
        weight = np.where(statistics.sd[0] > 0, statistics.df[0], 0.0)
        logs = np.log(np.where(weight > 0, 0.7 * statistics.sd[0], 1.0))
        self.spreads = {
            "sigma": Spread(p.log_s_mean, loads * [p.log_s_sd, p.kappa_sd, p.psi_sd], logs, weight)
        }
        if statistics.repeats:
            df, scatter = statistics.trial_df, statistics.trial_rows[0, 0] ** 2
            known = (df > 0) & (scatter > 0)
            logs = 0.5 * np.log(np.where(known, scatter, 1.0) / np.maximum(df, 1.0))
            loads_e = loads * [p.log_s_e_sd, p.kappa_e_sd, p.psi_sd]
            self.spreads["sigma_e"] = Spread(
                p.log_s_e_mean, loads_e, logs, np.where(known, 2.0 * df, 0.0)
            )
        self._omegas = [f"omega{name.removeprefix('sigma')}" for name in self.spreads]
        self._scalars = ["sigma_u", "sigma_v", "tau", "tau_c", *self._omegas]
        spread_names = ("log_s", "kappa", "psi", *statistics.environments)
        cells = [f"{s}[{cell}]" for s in self.spreads for cell in spread_names]
        self.names = [*self._scalars, *cells]
        trials = sum(part.subjects * part.trials.sum() for part in statistics.patterns)
        # The statistics' constant is of pattern means of covariance D/n; here n of covariance D are
        # weighed.
        means = sum(part.environments.size * np.log(part.subjects) for part in statistics.patterns)
        self._constant = statistics.constant - 0.5 * (_LOG_2PI * float(trials) - float(means))

    def identity(self) -> tuple[object, ...]:
        """Everything that decides density and contrasts."""
        data, priors = dataclasses.astuple(self.statistics), dataclasses.astuple(self._priors)
        return ("within subjects", data, priors, self.reference, self._c, self._references)

    def named(self, points: Array) -> tuple[dict[str, Array], Array]:
        """Scales by name at coordinates (W, d), shape (W,) or (W, M), and their log prior density."""
        p = self._priors
        wide = {"sigma_u": p.sigma_u_scale, "sigma_v": p.sigma_u_scale, "tau": p.tau_scale}
        wide |= {"tau_c": p.tau_scale, "omega": p.omega_scale, "omega_e": p.omega_e_scale}
        scalars = self._scalars
        named = {name: half_normal(points[:, i], wide[name]) for i, name in enumerate(scalars)}
        log_prior = -0.5 * ((points[:, : len(scalars)] ** 2).sum(axis=1) + _LOG_2PI * len(scalars))
        parts = np.split(points[:, len(scalars) :], len(self.spreads), axis=1)
        for (name, spread), omega, own in zip(
            self.spreads.items(), self._omegas, parts, strict=True
        ):
            logs, log_density = spread(own, named[omega])
            named[name] = np.exp(logs)
            log_prior = log_prior + log_density
        return named, log_prior

    def __call__(self, points: Array) -> Array:
        """Log density of coordinates (W, d), shape (W,)."""
        inside = np.all(np.abs(points) <= LIMIT, axis=1)
        value = np.full(len(points), -np.inf)
        rows = np.flatnonzero(inside)
        for at in np.split(rows, range(_PASS, len(rows), _PASS)):
            if len(at):
                named, log_prior = self.named(points[at])
                value[at] = log_prior + self.locations(named).log_density
        return np.where(np.isnan(value), -np.inf, value)

    def locations(self, named: dict[str, Array]) -> _Locations:
        """Law of the cell means given scales."""
        p, c, x = self._priors, self._c, self._x
        width = len(named["tau"])
        fixed = np.stack([p.alpha_sd * np.ones_like(x), p.gamma_sd * x, p.lambda_sd * c], axis=1)
        own, apart = (
            named[name][:, None, None] * at
            for name, at in (("tau", self._at), ("tau_c", c[:, None] * self._at))
        )
        rows = np.concatenate([np.broadcast_to(fixed, (width, *fixed.shape)), own, apart], axis=2)
        precision, right = np.eye(rows.shape[2]), np.zeros((width, rows.shape[2]))
        white, log_density = [], np.full(width, self._constant)
        if "sigma_e" in named:
            df, squares = self.statistics.trial_df, self.statistics.trial_rows[0, 0] ** 2
            log_density -= (
                0.5 * squares / named["sigma_e"] ** 2 + df * np.log(named["sigma_e"])
            ).sum(axis=1)
        for part in self.statistics.patterns:
            e, n = part.environments, part.subjects
            noise = named["sigma"][:, e] ** 2
            if "sigma_e" in named:
                noise = noise + named["sigma_e"][:, e] ** 2 / part.trials
            covariance = noise[:, :, None] * np.eye(len(e)) + (named["sigma_u"] ** 2)[:, None, None]
            covariance = covariance + (named["sigma_v"] ** 2)[:, None, None] * np.outer(c[e], c[e])
            factor = cholesky(covariance)
            scatter = _solve(
                factor, np.broadcast_to(part.rows[0].T, (width, *part.rows[0].T.shape))
            )
            log_density -= 0.5 * (scatter**2).sum(axis=(1, 2)) + n * np.log(_diagonal(factor)).sum(
                axis=1
            )
            design = np.sqrt(n) * _solve(factor, rows[:, e])
            means = np.sqrt(n) * _solve(
                factor, np.broadcast_to(part.mean[0][:, None], (width, len(e), 1))
            )
            turned = np.swapaxes(design, 1, 2)
            precision = precision + turned @ design
            right = right + (turned @ means)[..., 0]
            white.append((design, means))
        factor = cholesky(precision)
        mean = _solve(precision, right[..., None])
        # Squares of what is left, and of the prior's: nothing is subtracted from a large number.
        squares = (mean**2).sum(axis=(1, 2))
        squares = squares + sum(
            ((means - design @ mean) ** 2).sum(axis=(1, 2)) for design, means in white
        )
        log_density -= 0.5 * squares + np.log(_diagonal(factor)).sum(axis=1)
        return _Locations(rows, mean[..., 0], factor, log_density)

    def laws(self, points: Array) -> ConditionalMoments:
        """Law of the contrasts at coordinates (W, d), and of users about them, trial noise left out."""
        split = np.split(points, range(_PASS, len(points), _PASS))
        parts = [self.contrasts(self.named(part)[0]) for part in split]
        return ConditionalMoments(*(np.concatenate(own) for own in zip(*parts, strict=True)))

    def contrasts(self, named: dict[str, Array]) -> tuple[Array, Array, Array]:
        """Mean and SD of the contrasts given scales, and the SD of users about them, each (W, J + 1)."""
        law = self.locations(named)
        rows = self._contrast @ law.rows
        spread = _solve(law.factor, np.swapaxes(rows, 1, 2))
        users = named["sigma_v"][:, None] ** 2 + named["sigma"] ** 2 @ (self._contrast**2).T
        return (
            (rows @ law.mean[..., None])[..., 0],
            np.sqrt((spread**2).sum(axis=1)),
            np.sqrt(users),
        )

    def spread_ratios(self, points: Array) -> Array:
        """SD between users at the second level over that at the first, per contrast, (W, J + 1)."""
        named, _ = self.named(points)
        shared = (named["sigma_u"] ** 2 + 0.25 * named["sigma_v"] ** 2)[:, None]
        first, second = (
            shared
            + named["sigma"] ** 2 @ (np.where(self._c * sign > 0, self._contrast, 0.0) ** 2).T
            for sign in (-1.0, 1.0)
        )
        return np.asarray(np.sqrt(second / first))

    def scales(self, points: Array) -> Named:
        """Named scales at coordinates: dimensions and values, draws first."""
        return draws_first({name: value.T for name, value in self.named(points)[0].items()})


def _solve(matrices: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(matrices, right), dtype=np.float64)


def _diagonal(factor: Array) -> Array:
    """Diagonals (W, M) of matrices (W, M, M)."""
    return np.diagonal(factor, axis1=1, axis2=2)
