"""Limits of studies with factors by nutpie, beside percept's.

PyMC has the model as `factor_studies` draws from it: locations, deviations and subjects' effects
are sampled. Only a subject's departure in a cell is summed into the scatter of the cell's mean. It
needs the extra `peers`.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from percept.calibration.studies import Line, plan_digest
from percept.inference.hierarchy.contrasts import ContrastEstimands
from percept.inference.hierarchy.interval_estimands import IntervalEstimands
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from percept.provenance import made_by, markdown_table
from reports.calibration.factor_studies import (
    DECADES,
    ENVIRONMENTS,
    GROUP,
    KINDS,
    PRIORS,
    Drawn,
    draw_study,
    model_of,
)
from reports.calibration.factors import Rows, contrast_rows
from reports.store import store

Array: TypeAlias = NDArray[np.float64]
#: A number or an array of PyMC, or of numpy; PyMC has no types.
Term: TypeAlias = Any

LEVEL = 0.9
#: Monte Carlo error of percept's limits, over the half-width.
TOLERANCE = 0.01
CHAINS = 4
#: Shorter steps than by default: divergences would bias the comparison.
ACCEPTANCE = 0.97
#: Draws of each chain that are not kept.
WARM_UP = 1500
#: Combined errors within which nearly all limits must lie, and all.
NEARLY_ALL = 3.0
ALL = 4.5
SHARE = 0.99
PAGE = """# Limits of studies with factors, next to nutpie's

One study of each kind is fitted by percept and by nutpie ({chains} chains of {draws:,} draws). PyMC
has the model written plainly, with locations and subjects' effects as unknowns. Limits at
{level:.0%} of means and of the next user are compared, for cells, contrasts and slopes of
covariates. A difference is divided by the root of the sum of both squared Monte Carlo errors.

{made}

{table}

Of all {count} limits, {near:.1%} lie within {nearly_all:g} combined errors, and the farthest at
{farthest:.2g}. At least {share:.0%} must lie within {nearly_all:g}, and all within {all_of:g}.

The `error` columns are root mean squares of Monte Carlo errors over half-widths.

## The ten farthest limits

{worst}
"""


class _Plain:
    """Unknowns of the model, written inside a PyMC model; quantities first."""

    def __init__(self, drawn: Drawn) -> None:
        self.size = len(drawn.kind.parameters)
        self.x = DECADES[drawn.environment]
        self.drawn = drawn

    def normal(self, name: str, sd: float, *shape: int, centre: float = 0.0) -> Term:
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
        shape = PRIORS.rho_shape
        return pm.Deterministic(name, 2.0 * pm.Beta(f"half_{name}", shape, shape) - 1.0)

    def deviations(self, name: str) -> Term:
        """Return what each environment has of its own, at the cells."""
        tau = self.half(name, PRIORS.tau_scale)
        z = self.normal(f"z_{name}", 1.0, len(ENVIRONMENTS))
        return (tau[:, None] * z)[:, self.drawn.environment]

    def locations(self) -> Term:
        """Return the means of the cells."""
        import pymc as pm

        beta = self.normal("alpha", PRIORS.alpha_sd)[:, None]
        beta = beta + self.normal("gamma", PRIORS.gamma_sd)[:, None] * self.x
        beta = beta + self.deviations("tau")
        for term, contrast in self.drawn.contrast.items():
            coefficient = self.normal(f"lambda_{term}", PRIORS.lambda_sd)[:, None]
            beta = beta + contrast * (coefficient + self.deviations(f"tau_{term}"))
        return pm.Deterministic("beta", beta)

    def sds(self, suffix: str) -> Term:
        """Return the SDs of all cells at one level of scatter."""
        import pymc as pm

        centre = getattr(PRIORS, f"log_s{suffix}_mean")
        log_s = self.normal(f"log_s{suffix}", getattr(PRIORS, f"log_s{suffix}_sd"), centre=centre)
        kappa = self.normal(f"kappa{suffix}", getattr(PRIORS, f"kappa{suffix}_sd"))
        log_sigma = log_s[:, None] + kappa[:, None] * self.x
        for factor in self.drawn.kind.factors:
            psi = self.normal(f"psi{suffix}_{factor}", PRIORS.psi_sd)[:, None]
            log_sigma = log_sigma + psi * self.drawn.contrast[factor]
        omega = self.half(f"omega{suffix}", getattr(PRIORS, f"omega{suffix}_scale"))
        z = self.normal(f"z{suffix}", 1.0, len(self.x))
        return pm.Deterministic(f"sigma{suffix}", pm.math.exp(log_sigma + omega[:, None] * z))

    def stretch(self) -> Term:
        """Return the sizes of subjects' effects in the cells."""
        import pymc as pm

        log_size: Term = np.zeros((self.size, len(self.x)))
        for factor in self.drawn.kind.spread:
            eta = self.normal(f"eta_{factor}", PRIORS.psi_sd)[:, None]
            log_size = log_size + eta * self.drawn.contrast[factor]
        return pm.Deterministic("stretch", pm.math.exp(log_size))

    def effects(self) -> Term:
        """Return what every subject adds to the cells, before it is stretched, (P, N, C)."""
        import pymc as pm

        total: Term = 0.0
        for name, contrast in subject_columns(self.drawn).items():
            sd = self.half(f"sigma_{name}", PRIORS.sigma_u_scale)
            rho = self.correlation(f"rho_{name}")
            z = self.normal(f"z_{name}", 1.0, self.drawn.kind.subjects)
            effects = [sd[0] * z[0]]
            if self.size == 2:
                effects.append(sd[1] * (rho * z[0] + pm.math.sqrt(1.0 - rho**2) * z[1]))
            total = total + pm.math.stack(effects)[:, :, None] * contrast
        return total


def subject_columns(drawn: Drawn) -> dict[str, Array]:
    """Return columns of the subjects' effects over the cells, by name."""
    columns = {"u": np.ones(len(drawn.environment))}
    for term, contrast in drawn.contrast.items():
        if GROUP not in term.split(":"):
            columns[f"v_{term}"] = contrast
    return columns


def plain_model(drawn: Drawn) -> Any:
    """Write the model of a study in PyMC."""
    import pymc as pm

    cells = len(drawn.environment)
    pair, trial_pair, trials = np.unique(
        drawn.subject * cells + drawn.cell, return_inverse=True, return_counts=True
    )
    subject, cell = np.divmod(pair, cells)
    averaging = np.zeros((len(pair), len(trial_pair)))
    averaging[trial_pair, np.arange(len(trial_pair))] = 1.0 / trials[trial_pair]
    mean = averaging @ drawn.response
    departure: Term = drawn.response - mean[trial_pair]
    with pm.Model() as model:
        plain = _Plain(drawn)
        size = plain.size
        beta = plain.locations()
        shared = plain.effects() * plain.stretch()[:, None, :]
        location = beta[:, cell] + shared[:, subject, cell]
        sigma = plain.sds("")[:, cell]
        variances = [sigma[p] ** 2 for p in range(size)]
        covariance = plain.correlation("rho_w") * sigma[0] * sigma[-1]
        if drawn.kind.covariate:
            slope = plain.normal("slope", PRIORS.covariate_sd)
            mean_covariate = averaging @ drawn.covariate[:, 0]
            location = location + slope[:, None] * mean_covariate
            off = drawn.covariate[:, 0] - mean_covariate[trial_pair]
            departure = departure - slope * off[:, None]
        if drawn.kind.trials[1] > 1:
            sigma_e = plain.sds("_e")[:, cell]
            if drawn.kind.own_trial_sds:
                omega_s = plain.half("omega_s", PRIORS.omega_s_scale)
                phi = omega_s[:, None] * plain.normal("z_phi", 1.0, drawn.kind.subjects)
                sigma_e = sigma_e * pm.math.exp(phi)[:, subject]
            rho_e = plain.correlation("rho_e")
            trial_variances = [sigma_e[p] ** 2 for p in range(size)]
            trial_covariance = rho_e * sigma_e[0] * sigma_e[-1]
            # Departures from a mean of n trials have the density of n - 1 trials.
            log_density = _quadratic(
                [departure[:, p] for p in range(size)],
                [variance[trial_pair] for variance in trial_variances],
                trial_covariance[trial_pair],
            )
            log_determinant = _log_determinant(trial_variances, trial_covariance)
            pm.Potential(
                "departures", log_density.sum() - 0.5 * ((trials - 1) * log_determinant).sum()
            )
            variances = [variances[p] + trial_variances[p] / trials for p in range(size)]
            covariance = covariance + trial_covariance / trials
        residuals = [mean[:, p] - location[p] for p in range(size)]
        log_density = _quadratic(residuals, variances, covariance)
        log_density = log_density - 0.5 * _log_determinant(variances, covariance)
        pm.Potential("means", log_density.sum())
    return model


def _quadratic(residuals: Sequence[Term], variances: Sequence[Term], covariance: Term) -> Term:
    """Return minus half the squared distance of one or two quantities."""
    if len(residuals) == 1:
        return -0.5 * residuals[0] ** 2 / variances[0]
    first, second = residuals
    determinant = variances[0] * variances[1] - covariance**2
    squares = variances[1] * first**2 + variances[0] * second**2 - 2.0 * covariance * first * second
    return -0.5 * squares / determinant


def _log_determinant(variances: Sequence[Term], covariance: Term) -> Term:
    import pymc as pm

    if len(variances) == 1:
        return pm.math.log(variances[0])
    return pm.math.log(variances[0] * variances[1] - covariance**2)


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Lower and upper limits by name, with their Monte Carlo errors."""

    value: dict[str, float]
    error: dict[str, float]


def percept_limits(model: LinearPosterior, rows: Rows, *, tolerance: float) -> Limits:
    """Return limits of means and users by percept."""
    claims = IntervalEstimands(model, kinds=("mean", "user"), level=LEVEL)
    users = (*model.cells, *(("contrast", name) for name in rows.names))
    groups = tuple(("contrast", name) for name in rows.group_names)
    estimands = ContrastEstimands(model, rows.weights, users, groups, claims)
    run = sample(model, estimands, Settings(tolerance=tolerance, seed=1))
    assert run.gate.passed, run.gate.reasons
    assert run.gate.tolerance_met, run.gate.error_reached
    names = [",".join(pair) for pair in model.cells] + list(rows.names)
    value = run.estimates.value
    of_users = value[: 4 * len(names)].reshape(2, 2, -1)
    error_of_users = run.errors[: 4 * len(names)].reshape(2, 2, -1)
    values = {}
    errors = {}
    for k, kind in enumerate(("mean", "user")):
        for s, side in enumerate(("lower", "upper")):
            for number, name in enumerate(names):
                values[f"{kind} {name} {side}"] = of_users[k, s, number]
                errors[f"{kind} {name} {side}"] = error_of_users[k, s, number]
    of_groups = value[4 * len(names) :].reshape(2, -1)
    error_of_groups = run.errors[4 * len(names) :].reshape(2, -1)
    for s, side in enumerate(("lower", "upper")):
        for number, name in enumerate(rows.group_names):
            values[f"mean {name} {side}"] = of_groups[s, number]
            errors[f"mean {name} {side}"] = error_of_groups[s, number]
    return Limits(values, errors)


def nutpie_limits(
    drawn: Drawn, model: LinearPosterior, rows: Rows, plan: Plan
) -> tuple[Limits, int]:
    """Return limits of means and users by nutpie, and how many of its draws diverged.

    Those of means are quantiles of its draws. A user's law given a draw is normal.
    """
    # nutpie's arviz imports arviz-plots if it is there. Release 0.8 wants this module, which
    # matplotlib 3.11 no longer imports itself.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import matplotlib.style.core  # noqa: F401
    import nutpie
    from arviz_stats.base.array import BaseArray

    compiled = nutpie.compile_pymc_model(plain_model(drawn))
    tree = nutpie.sample(
        compiled,
        draws=plan.draws,
        tune=plan.warm_up,
        chains=CHAINS,
        cores=1,
        seed=plan.seed,
        target_accept=plan.acceptance,
        progress_bar=False,
        save_warmup=False,
    )
    posterior = {name: np.asarray(tree.posterior[name]) for name in tree.posterior.data_vars}
    locations = posterior["beta"].reshape(CHAINS, plan.draws, -1)
    if drawn.kind.covariate:
        locations = np.concatenate([locations, posterior["slope"]], axis=2)
    weights = rows.weights
    every = np.vstack([weights.cells, weights.users, weights.groups])
    names = [",".join(pair) for pair in model.cells] + [*rows.names, *rows.group_names]
    of_users = len(model.cells) + len(rows.names)
    array_stats: Any = BaseArray()
    values = {}
    errors = {}
    for number, (name, row) in enumerate(zip(names, every, strict=True)):
        mean = locations @ row  # (chains, draws)
        for side, tail in (("lower", 0.5 - 0.5 * LEVEL), ("upper", 0.5 + 0.5 * LEVEL)):
            values[f"mean {name} {side}"] = float(np.quantile(mean, tail))
            errors[f"mean {name} {side}"] = float(
                array_stats.mcse(mean, method="quantile", prob=tail)
            )
            if number < of_users:
                value, error = _user_limit(mean, user_sd(drawn, posterior, row), tail, array_stats)
                values[f"user {name} {side}"] = value
                errors[f"user {name} {side}"] = error
    return Limits(values, errors), int(np.sum(tree.sample_stats.diverging))


def user_sd(drawn: Drawn, posterior: Mapping[str, Array], row: Array) -> Array:
    """Return the SD of one user's own combination of the cells of one quantity, (chains, draws)."""
    size, cells = drawn.beta.shape
    by_quantity = row[: size * cells].reshape(size, cells)
    (p,) = np.flatnonzero(by_quantity.any(axis=1))
    weight = by_quantity[p]
    stretch = posterior["stretch"][:, :, p]
    variance = (posterior["sigma"][:, :, p] ** 2) @ weight**2
    for name, contrast in subject_columns(drawn).items():
        size_of_effect = posterior[f"sigma_{name}"][:, :, p]
        variance = variance + (size_of_effect * (stretch @ (weight * contrast))) ** 2
    return np.asarray(np.sqrt(variance))


def _user_limit(mean: Array, sd: Array, tail: float, array_stats: Any) -> tuple[float, float]:
    """Return the quantile of a mixture of normal laws, and its Monte Carlo error."""

    def excess(limit: float) -> float:
        return special.ndtr((limit - mean) / sd).mean() - tail

    limit = optimize.brentq(excess, (mean - 9.0 * sd).min(), (mean + 9.0 * sd).max(), xtol=1e-10)
    score = (limit - mean) / sd
    density = np.mean(np.exp(-0.5 * score**2) / (np.sqrt(2.0 * np.pi) * sd))
    error = float(array_stats.mcse(special.ndtr(score), method="mean"))
    return float(limit), error / float(density)


@dataclasses.dataclass(frozen=True)
class Difference:
    """One limit by both samplers."""

    kind: str
    name: str
    errors_apart: float  # Difference over the combined Monte Carlo error
    percept_error: float  # Over the half-width
    nutpie_error: float  # Over the half-width


@dataclasses.dataclass(frozen=True)
class Plan:
    """How the studies are fitted by both."""

    draws: int  # Of each of nutpie's chains
    seed: int = 11  # Of the studies and of nutpie
    tolerance: float = TOLERANCE
    warm_up: int = WARM_UP
    acceptance: float = ACCEPTANCE


def compare(plan: Plan, number: int) -> Line:
    """Return differences of all limits of one kind of study, and nutpie's divergences."""
    kind = list(KINDS)[number]
    drawn = draw_study(KINDS[kind], np.random.default_rng(plan.seed))
    model = model_of(drawn)
    rows = contrast_rows(drawn, model)
    ours = percept_limits(model, rows, tolerance=plan.tolerance)
    theirs, divergences = nutpie_limits(drawn, model, rows, plan)
    assert ours.value.keys() == theirs.value.keys()
    differences = []
    for name, value in ours.value.items():
        stem = name.rpartition(" ")[0]
        half_width = 0.5 * (ours.value[f"{stem} upper"] - ours.value[f"{stem} lower"])
        combined = np.hypot(ours.error[name], theirs.error[name])
        difference = Difference(
            kind=kind,
            name=name,
            errors_apart=float((theirs.value[name] - value) / combined),
            percept_error=float(ours.error[name] / half_width),
            nutpie_error=float(theirs.error[name] / half_width),
        )
        differences.append(dataclasses.asdict(difference))
    return {"differences": differences, "divergences": divergences}


def _row(differences: Sequence[Difference], divergences: int) -> list[object]:
    """Return one kind of study in the table."""
    apart = np.abs([difference.errors_apart for difference in differences])
    errors = []
    for field in ("percept_error", "nutpie_error"):
        squares = np.square([getattr(difference, field) for difference in differences])
        errors.append(f"{np.sqrt(squares.mean()):.2%}")
    near = np.mean(apart <= NEARLY_ALL)
    kind = differences[0].kind
    return [kind, len(apart), f"{near:.1%}", f"{apart.max():.2g}", *errors, divergences]


def compared(draws: int, folder: Path, typed: str) -> tuple[bool, str]:
    """Fit what is not kept yet by both; say whether the limits differ, and write the page."""
    plan = Plan(draws)
    rows = []
    every = []
    for both in store(folder, plan_digest(plan)).complete(
        functools.partial(compare, plan), len(KINDS)
    ):
        differences = [Difference(**fields) for fields in both["differences"]]
        rows.append(_row(differences, both["divergences"]))
        every += differences
    every.sort(key=lambda difference: -abs(difference.errors_apart))
    apart = np.abs([difference.errors_apart for difference in every])
    near = np.mean(apart <= NEARLY_ALL)
    heads = ["kind", "limits", "within 3", "farthest", "percept error", "nutpie error", "diverged"]
    worst = [[own.kind, own.name, f"{own.errors_apart:.2f}"] for own in every[:10]]
    text = PAGE.format(
        chains=CHAINS,
        draws=draws,
        level=LEVEL,
        made=made_by(typed, ("pymc", "nutpie")).sentence,
        table=markdown_table(heads, rows),
        count=len(apart),
        near=near,
        nearly_all=NEARLY_ALL,
        farthest=apart.max(),
        share=SHARE,
        all_of=ALL,
        worst=markdown_table(["kind", "limit", "combined errors"], worst),
    )
    return bool(near < SHARE or apart.max() > ALL), text
