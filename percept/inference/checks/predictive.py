"""What the model says before the data, of new studies like this one, and of the data it pooled."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.blocks import Block, Pair
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.priors import Priors, draws_first
from percept.inference.hierarchy.scales import Layout, Scales

Array = NDArray[np.float64]
Named = dict[str, tuple[tuple[str, ...], Array]]
STATISTICS = ("mean", "sd", "farthest")
#: Which priors speak of what.
GROUPS = {
    "bias": ("alpha", "gamma", "tau"),
    "spread": ("s", "kappa", "omega", "sigma"),
    "subjects": ("sigma_u",),
    "trials": ("s_e", "kappa_e", "omega_e", "sigma_e"),
    "correlation": ("rho_w", "rho_u", "rho_e"),
}
_CHUNK = 512
#: Raw mean and trend this close, in posterior SDs of the centre, leave nothing to move through.
_APART = 0.1
_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclasses.dataclass(frozen=True, eq=False)
class Shrinkage:
    """Centres of the environments before and after pooling, on the response scale; all (P, J)."""

    raw: Array  # Mean over subjects of their cell means
    centre: Array
    trend: Array
    sd: Array  # Posterior SD of the location
    moved: Array  # Fraction of the way from raw to trend; NaN where they coincide


def prior_layout(density: CollapsedDensity) -> Layout:
    """Layout of the same model without data, in which every coordinate is standard normal a priori."""
    statistics = density.statistics
    # Only the observed scatter sets the coordinates of log sigma off their prior.
    blank = dataclasses.replace(
        statistics, sd=np.zeros_like(statistics.sd), trial_rows=np.zeros_like(statistics.trial_rows)
    )
    return Layout(blank, density.priors, density.layout.options)


def draw_prior(density: CollapsedDensity, draws: int, rng: np.random.Generator) -> tuple[Named, Array, Array]:
    """Draw scales, population means and new users before any data."""
    layout, priors = prior_layout(density), density.priors
    scales = layout.scales(rng.standard_normal((layout.dimension, draws)))
    size, environments = layout.parameters, layout.environments
    beta = np.repeat(priors.alpha_sd * rng.standard_normal((size, 1, draws)), environments, axis=1)
    if scales.tau is not None:
        gamma = priors.gamma_sd * rng.standard_normal((size, 1, draws))
        beta += gamma * density.statistics.x[..., None]
        beta += np.stack(scales.tau)[:, None] * rng.standard_normal(beta.shape)
    user = beta.copy()
    for column in scales.between.factor_columns():
        user += np.stack(column) * rng.standard_normal(beta.shape[1:])
    for column in scales.shared.factor_columns() if scales.shared is not None else ():
        user += np.stack(column)[:, None] * rng.standard_normal(beta.shape[1:])
    return draws_first(scales.named), beta.reshape(-1, draws).T, user.reshape(-1, draws).T


def draw_trend(
    density: CollapsedDensity, scales: Scales, beta: Array, rng: np.random.Generator | None = None
) -> tuple[Array, Array]:
    """Level alpha and slope gamma per decade given the locations: a regression of its own per parameter."""
    assert scales.tau is not None
    priors = density.priors
    weight = 1.0 / np.stack(scales.tau) ** 2
    coefficients = []
    # x is centred, so level and slope are independent given the locations.
    for x, prior_sd in (
        (np.ones_like(density.statistics.x), priors.alpha_sd),
        (density.statistics.x, priors.gamma_sd),
    ):
        precision = weight * np.square(x).sum(axis=1)[:, None] + prior_sd**-2.0
        value = weight * np.einsum("pj,pjw->pw", x, beta) / precision
        if rng is not None:
            value = value + rng.standard_normal(value.shape) / np.sqrt(precision)
        coefficients.append(value)
    return coefficients[0], coefficients[1]


def log_prior(density: CollapsedDensity, scales: Scales, beta: Array, rng: np.random.Generator) -> Named:
    """Log density of each top-level prior, on the scale the prior is stated on; see `log_scale_priors`."""
    priors = density.priors
    if scales.tau is None:
        trend = {"alpha": log_normal_density(beta[:, 0], 0.0, priors.alpha_sd)}
    else:
        alpha, gamma = draw_trend(density, scales, beta, rng)
        trend = {
            "alpha": log_normal_density(alpha, 0.0, priors.alpha_sd),
            "gamma": log_normal_density(gamma, 0.0, priors.gamma_sd),
        }
    return draws_first(trend | log_scale_priors(scales.named, priors, trend=density.layout.trend))


def log_scale_priors(named: Mapping[str, Array], priors: Priors, *, trend: bool) -> dict[str, Array]:
    """Log density of each top-level prior of scales and correlations.

    The laws of the environments' own SDs about their trend are part of the model, not priors: raising those
    to a power would ask what another model says.
    """
    found: dict[str, Array] = {}
    for name in ("tau", "sigma_u", "omega", "omega_e"):
        if name in named:
            found[name] = np.log(2.0) + log_normal_density(named[name], 0.0, getattr(priors, f"{name}_scale"))
    for suffix in ("", "_e"):
        mean, sd = getattr(priors, f"log_s{suffix}_mean"), getattr(priors, f"log_s{suffix}_sd")
        level = ("s" if trend else "sigma") + suffix
        if level in named:
            found[level] = log_normal_density(np.log(named[level]), mean, sd)
        slope = "kappa" + suffix
        if slope in named:
            found[slope] = log_normal_density(named[slope], 0.0, getattr(priors, f"{slope}_sd"))
    for name in ("rho_w", "rho_u", "rho_e"):
        if name in named:
            found[name] = _beta(named[name], priors)
    return found


def log_normal_density(value: Array, mean: float, sd: float) -> Array:
    """Log density of N(mean, sd²)."""
    standard = (value - mean) / sd
    return np.asarray(-0.5 * (standard * standard + _LOG_2PI) - np.log(sd))


def _beta(rho: Array, priors: Priors) -> Array:
    shape = priors.rho_shape
    # Draws at ±1 to the last digit have a density of zero when the shape is above one.
    inside = np.maximum((1.0 - rho) * (1.0 + rho) / 4.0, np.finfo(float).tiny)
    return np.asarray((shape - 1.0) * np.log(inside) - special.betaln(shape, shape) - np.log(2.0))


def statistics_of(cell_means: Array) -> Array:
    """Mean, SD, and the farthest subject's distance from the mean in SDs, of every cell."""
    present = np.isfinite(cell_means)
    n = present.sum(axis=-3)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(present, cell_means, 0.0).sum(axis=-3) / n
        off = np.where(present, cell_means - mean[..., None, :, :], 0.0)
        sd = np.sqrt(np.square(off).sum(axis=-3) / (n - 1.0))
        farthest = np.where(n > 2, np.abs(off).max(axis=-3) / sd, np.nan)
    return np.stack([mean, np.where(n > 1, sd, np.nan), farthest], axis=-3)


def replicate(subjects: SubjectDensity, points: Array, rng: np.random.Generator) -> Array:
    """Statistics of new studies of the same design, one per draw."""
    density, studies = subjects.density, []
    for _, scales in subjects.batches(points):
        beta = density.locations(scales).draw(rng)
        width = beta.shape[-1]
        drawn = np.full((width, subjects.subjects, subjects.parameters, subjects.environments), np.nan)
        for pattern, cell in zip(density.statistics.patterns, density.cell_blocks(scales), strict=True):
            shape = (pattern.subjects, pattern.environments.size, width)
            values = np.broadcast_to(
                beta[:, None, pattern.environments], (subjects.parameters, *shape)
            ).copy()
            for column in cell.factor_columns():
                values += np.stack(column)[:, None] * rng.standard_normal(shape)
            for column in scales.shared.factor_columns() if scales.shared is not None else ():
                values += np.stack(column)[:, None, None] * rng.standard_normal((shape[0], 1, width))
            drawn[:, pattern.members[:, None], :, pattern.environments] = values.transpose(1, 2, 3, 0)
        studies.append(statistics_of(drawn))
    return np.concatenate(studies)


def shrinkage(density: CollapsedDensity, points: Array) -> Shrinkage | None:
    """How far each environment's centre was drawn to the trend over environments."""
    if not density.layout.trend:
        return None
    sums = [0.0, 0.0, 0.0]
    x = density.statistics.x[..., None]
    step = density.draws_per_pass
    for start in range(0, len(points), step):
        scales = density.layout.scales(np.ascontiguousarray(points[start : start + step].T))
        law = density.locations(scales)
        beta = np.stack(law.mean)
        # Level and slope are linear in the locations: their mean follows from the locations' mean.
        alpha, gamma = draw_trend(density, scales, beta)
        trend = alpha[:, None] + gamma[:, None] * x
        square = np.square(beta) + np.stack(law.covariance.diagonal())
        sums = [total + part.sum(axis=-1) for total, part in zip(sums, (beta, trend, square), strict=True)]
    centre, trend, square = (np.asarray(total) / len(points) for total in sums)
    raw = np.nanmean(density.statistics.cell_means, axis=0)
    sd = np.sqrt(np.maximum(square - np.square(centre), 0.0))
    gap = trend - raw
    moved = np.divide(centre - raw, gap, out=np.full_like(raw, np.nan), where=np.abs(gap) > _APART * sd)
    return Shrinkage(raw, centre, trend, sd, moved)


def correlation_draws(density: CollapsedDensity, points: Array) -> dict[str, Array]:
    """Draws of the correlations of stiffness and damping between users."""
    if density.layout.parameters == 1:
        return {}
    parts = [_correlations(density, points[i : i + _CHUNK]) for i in range(0, len(points), _CHUNK)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _correlations(density: CollapsedDensity, points: Array) -> dict[str, Array]:
    scales = density.layout.scales(np.ascontiguousarray(points.T))
    correlations = {"within": scales.named["rho_w"]}
    if scales.shared is not None:
        correlations["shared"] = scales.named["rho_u"]
    return correlations | {"population": _correlation(density.population(scales)).T}


def _correlation(block: Block) -> Array:
    """Slope times the ratio of SDs, from the regression a pair is kept as."""
    assert isinstance(block, Pair)
    first, second = block.diagonal()
    return block.g * np.sqrt(first / second)
