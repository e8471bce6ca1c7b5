"""The posterior as a DataTree in ArviZ's groups; and where one prior has moved it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

import percept
from percept.inference.checks.predictive import draw_prior, log_prior
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.models import Pooled
from percept.study.basics import Array, Stream, generator
from percept.study.fit import Fit

#: By variable: dimensions after the draw, and values (draws, ...).
Named = dict[str, tuple[Sequence[str], Array]]
#: Log likelihoods (draws times subjects) that a tree holds; larger studies keep fewer draws.
_MOST = 1 << 24
#: Half-widths of the average user's interval from which a prior's pull is told; SDs of a prior taken as flat.
_PULL, _FLAT = 0.1, 1e3
#: Of a prior; or of the posterior, to be reweighted.
_DRAWS = 4000
_CELL = ("parameter", "environment")


def posterior_tree(fit: Fit, *, seed: int, full: bool) -> Any:
    """Collect scales, correlations, locations and new users, one chain per ensemble.

    In full the tree also holds what model checks by ArviZ need, where the model has subjects.
    """
    subjects = fit.subjects if full else None
    chains = len(fit.run.points)
    points = fit.points
    if isinstance(subjects, SubjectDensity):
        gap = -(-len(points) * subjects.subjects // _MOST)
        points = points.reshape(chains, -1, points.shape[1])[:, ::gap].reshape(-1, points.shape[1])
    grid = (len(fit.parameters), len(fit.environments))
    means, users = fit.model.draw(points, generator(seed, Stream.LOCATIONS))
    # Parameters that are modelled apart may have other environments.
    at = [fit.parameters.index(p) * grid[1] + fit.environments.index(e) for p, e in fit.model.cells]

    def in_cells(values: Array) -> tuple[Sequence[str], Array]:
        whole = np.full((len(values), *grid), np.nan)
        whole.reshape(len(values), -1)[:, at] = values.reshape(len(values), -1)
        return _CELL, whole

    groups: dict[str, Named] = {
        "posterior": {"population_mean": in_cells(fit.scale.native(means)), **fit.model.scales(points)},
        "posterior_predictive": {"new_user": in_cells(fit.scale.native(users))},
        "sample_stats": {"lp": ((), fit.model(points))},
    }
    before_data: dict[str, Named] = {}
    if isinstance(subjects, SubjectDensity):
        groups["posterior"]["population_sd"] = in_cells(fit.model.laws(points).population_sd)
        rng = generator(seed, Stream.PREDICTIVE)
        groups |= _log_densities(subjects, points, means.reshape(-1, *grid), rng)
        drawn, *of_prior = draw_prior(subjects.density, _DRAWS, rng)
        # Far tails of the priors' spread are beyond what a double holds.
        with np.errstate(over="ignore"):
            prior_means, prior_users = (in_cells(fit.scale.native(values)) for values in of_prior)
        before_data["prior"] = {**drawn, "population_mean": prior_means}
        before_data["prior_predictive"] = {"new_user": prior_users}
    labels = {
        "parameter": fit.parameters,
        "environment": fit.environments,
        "cell": [f"{p} in {e}" for p, e in fit.model.cells],
        "subject": list(fit.trials.subjects) if fit.trials else [],
    }
    return _tree(
        {name: (chains, named) for name, named in groups.items()}
        | {name: (1, named) for name, named in before_data.items()},
        labels,
    )


def _log_densities(
    subjects: SubjectDensity, points: Array, beta: Array, rng: np.random.Generator
) -> dict[str, Named]:
    """Log likelihood of each subject's trials given locations (S, P, J), and log density of each prior."""
    likelihood, priors = [], []
    for cut, scales in subjects.batches(points):
        at = np.moveaxis(beta[cut], 0, -1)
        likelihood.append(subjects.given_locations(scales, at))
        priors.append(log_prior(subjects.density, scales, at, rng))
    return {
        "log_likelihood": {"trials": (("subject",), np.concatenate(likelihood))},
        "log_prior": {
            name: (dims, np.concatenate([part[name][1] for part in priors]))
            for name, (dims, _) in priors[0].items()
        },
    }


def _tree(groups: Mapping[str, tuple[int, Named]], labels: Mapping[str, list[str]]) -> Any:
    """Build the DataTree of groups, each with its number of chains."""
    import xarray

    made_by = {"creation_library": "percept", "creation_library_version": percept.__version__}
    found = {}
    for group, (chains, named) in groups.items():
        variables = {
            name: (("chain", "draw", *dims), np.reshape(values, (chains, -1, *values.shape[1:])))
            for name, (dims, values) in named.items()
        }
        sizes = {
            dim: size
            for dims, values in variables.values()
            for dim, size in zip(dims, values.shape, strict=True)
        }
        coords = {dim: labels.get(dim, np.arange(size)) for dim, size in sizes.items()}
        found[group] = xarray.Dataset(variables, coords, made_by)
    return xarray.DataTree.from_dict(found)


def prior_pull(fit: Fit, subjects: SubjectDensity, *, level: float) -> tuple[str, ...]:
    """Say how far the prior of the common bias moves average users from where a flat one has them."""
    density = subjects.density
    flat = dataclasses.replace(density.priors, alpha_sd=_FLAT * density.priors.alpha_sd)
    free = CollapsedDensity(density.statistics, flat, density.layout.options, density.resolution)
    some = fit.points[:: max(1, len(fit.points) // _DRAWS)]
    own, other = (Pooled(one).laws(some) for one in (density, free))
    # Locations are integrated out of both densities, whose ratio tells how likely draws are under the other.
    weights = special.softmax(free(some) - density(some))
    half_width = special.ndtri(0.5 * (1.0 + level)) * np.hypot(own.sd, own.mean.std(axis=0)).mean(axis=0)
    moved = (own.mean.mean(axis=0) - weights @ other.mean) / half_width
    cells = ", ".join(
        f"{fit.quantities[p].label} in {e} ({moved[c]:+.2f})"
        for (p, e), c in fit.column.items()
        if abs(moved[c]) > _PULL
    )
    if not cells:
        return ()
    return (
        f"The prior of the common bias, N(0, {density.priors.alpha_sd:g}²), moves the estimate of the "
        f"average user, in half-widths of the interval: {cells}. It expects settings near their references. "
        "Where these or their unit are arbitrary, set a larger alpha_sd in [model.priors].",
    )
