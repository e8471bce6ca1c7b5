"""The posterior in groups of named arrays, as ArviZ keeps them; and as its DataTree."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

import percept
from percept.inference.checks.predictive import draw_prior, log_prior
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.models import Pooled
from percept.study.streams import Stream, generator

if TYPE_CHECKING:
    from percept.study.bayesian import Fit

Array = np.ndarray[Any, Any]
#: Log likelihoods (draws times subjects) that a tree holds; larger studies keep fewer draws.
_MOST = 1 << 24
_PRIOR_DRAWS = 4000
_CELL = ["parameter", "environment"]


@dataclasses.dataclass(frozen=True, eq=False)
class Groups:
    """What a DataTree of a posterior is made of."""

    arrays: dict[str, dict[str, Array]]  # By group and variable, each (chains, draws per chain, ...)
    dims: dict[str, list[str]]  # By variable, names of the dimensions after chain and draw
    coords: dict[str, list[str]]  # Labels along a dimension


def thinned_points(fit: Fit) -> tuple[np.ndarray[Any, Any], int]:
    """Kept coordinates thinned to the effective size, (E N, d), with N per ensemble."""
    chosen = fit.run.independent()
    return chosen.reshape(-1, chosen.shape[-1]), chosen.shape[1]


def subject_density(fit: Fit) -> SubjectDensity | None:
    """Densities of the subjects' data; None for models other than the pooled one of sessions."""
    model, data = fit.prepared.model, fit.prepared.trials
    if not isinstance(model, Pooled) or data is None:
        return None
    return SubjectDensity(model.density, data.response, data.subject, data.environment)


def posterior_groups(fit: Fit, *, seed: int) -> Groups:
    """Collect scales, correlations, locations and new users, one chain per ensemble."""
    points, per_chain = thinned_points(fit)
    means, users = _draws(fit, points, seed)
    groups, dims = _posterior(fit, points, per_chain, means, users)
    return Groups(groups, dims, _coords(fit))


def full_groups(fit: Fit, *, seed: int) -> Groups:
    """Collect what model checks by ArviZ need beside the posterior too."""
    subjects = subject_density(fit)
    assert subjects is not None
    density = subjects.density
    points, per_chain = thinned_points(fit)
    gap = -(-len(points) * subjects.subjects // _MOST)
    points = points.reshape(-1, per_chain, points.shape[1])[:, ::gap].reshape(-1, points.shape[1])
    per_chain = -(-per_chain // gap)
    means, users = _draws(fit, points, seed)
    groups, dims = _posterior(fit, points, per_chain, means, users)
    grid = (len(density.statistics.parameters), len(density.statistics.environments))
    spread = fit.prepared.model.laws(points).population_sd
    groups["posterior"]["population_sd"] = spread.reshape(-1, per_chain, *grid)
    dims["population_sd"] = _CELL
    beta = means.reshape(-1, *grid)
    rng = generator(seed, Stream.PREDICTIVE)
    likelihood, priors = [], []
    for cut, scales in subjects.batches(points):
        at = np.moveaxis(beta[cut], 0, -1)
        likelihood.append(subjects.given_locations(scales, at))
        priors.append(log_prior(density, scales, at, rng))
    groups["log_likelihood"] = {
        "trials": np.concatenate(likelihood).reshape(-1, per_chain, subjects.subjects)
    }
    dims["trials"] = ["subject"]
    groups["log_prior"] = {}
    for name, (dimensions, value) in priors[0].items():
        joined = np.concatenate([part[name][1] for part in priors])
        groups["log_prior"][name] = joined.reshape(-1, per_chain, *value.shape[1:])
        dims[name] = list(dimensions)
    drawn, prior_means, prior_users = draw_prior(density, _PRIOR_DRAWS, rng)
    groups["prior"] = {name: value[None] for name, (_, value) in drawn.items()}
    # Far tails of the priors' spread are beyond what a double holds in N/m.
    with np.errstate(over="ignore"):
        native_means, native_users = (fit.prepared.scale.native(v) for v in (prior_means, prior_users))
    groups["prior"]["population_mean"] = native_means.reshape(1, -1, *grid)
    groups["prior_predictive"] = {"new_user": native_users.reshape(1, -1, *grid)}
    return Groups(groups, dims, {**_coords(fit), "subject": list(density.statistics.subjects)})


def _draws(fit: Fit, points: Array, seed: int) -> tuple[Array, Array]:
    """Draw locations and one new user each, on the response scale."""
    rng = generator(seed, Stream.LOCATIONS)
    return fit.prepared.model.draw(points, rng)


def _posterior(
    fit: Fit, points: Array, per_chain: int, means: Array, users: Array
) -> tuple[dict[str, dict[str, Array]], dict[str, list[str]]]:
    """Collect the groups that every model has, with the dimensions of their variables."""
    model, scale = fit.prepared.model, fit.prepared.scale
    parameters, environments = _labels(fit)

    def by_chain(values: Array, *shape: int) -> Array:
        return values.reshape(-1, per_chain, *shape)

    grid = (len(parameters), len(environments))
    posterior = {"population_mean": by_chain(scale.native(means), *grid)}
    dims = {"population_mean": _CELL, "new_user": _CELL}
    for name, (dimensions, values) in model.scales(points).items():
        posterior[name] = by_chain(values, *values.shape[1:])
        dims[name] = list(dimensions)
    groups = {
        "posterior": posterior,
        "posterior_predictive": {"new_user": by_chain(scale.native(users), *grid)},
        "sample_stats": {"lp": by_chain(model(points))},
    }
    return groups, dims


def _labels(fit: Fit) -> tuple[list[str], list[str]]:
    cells = fit.prepared.model.cells
    return list(dict.fromkeys(p for p, _ in cells)), list(dict.fromkeys(e for _, e in cells))


def _coords(fit: Fit) -> dict[str, list[str]]:
    parameters, environments = _labels(fit)
    cells = [f"{p} in {e}" for p, e in fit.prepared.model.cells]
    return {"parameter": parameters, "environment": environments, "cell": cells}


def data_tree(groups: Groups) -> Any:
    """Build an ArviZ DataTree."""
    import arviz_base

    tree = arviz_base.from_dict(groups.arrays, coords=groups.coords, dims=groups.dims)
    for node in tree.subtree:
        node.attrs.pop("created_at", None)
        node.attrs.pop("creation_library_language", None)
        node.attrs |= {"creation_library": "percept", "creation_library_version": percept.__version__}
    return tree
