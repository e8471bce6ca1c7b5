"""The posterior as an ArviZ DataTree with named dimensions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from percept.study.bayesian import Fit

__all__ = ["posterior_tree", "thinned_points"]


def thinned_points(fit: Fit) -> tuple[np.ndarray[Any, Any], int]:
    """Kept coordinates thinned to the effective size, (E N, d), with N per ensemble."""
    run = fit.run
    index = run.thinned()
    flat = run.points.reshape(run.points.shape[0], -1, run.points.shape[-1])
    chosen = flat[np.arange(len(flat))[:, None], index]
    return chosen.reshape(-1, chosen.shape[-1]), index.shape[1]


def posterior_tree(fit: Fit, *, seed: int) -> Any:
    """Build the DataTree: scales, correlations, locations and new users, one chain per ensemble.

    Parameters
    ----------
    fit : Fit
        A sampled posterior.
    seed : int
        Seed of the draws of locations and users given the scales.

    Returns
    -------
    DataTree
        Groups `posterior` (scales on the response scale; `population_mean` in N/m and N·s/m),
        `posterior_predictive` (`new_user`), `sample_stats` (`lp`).
    """
    import arviz_base

    model, scale = fit.prepared.model, fit.prepared.scale
    points, per_chain = thinned_points(fit)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(101,)))
    means, users = model.draw(points, rng)
    cells = model.cells
    parameters = list(dict.fromkeys(p for p, _ in cells))
    environments = list(dict.fromkeys(e for _, e in cells))

    def by_chain(values: np.ndarray[Any, Any], *shape: int) -> np.ndarray[Any, Any]:
        return values.reshape(-1, per_chain, *shape)

    grid = (len(parameters), len(environments))
    posterior = {"population_mean": by_chain(scale.native(means), *grid)}
    dims: dict[str, list[str]] = {"population_mean": ["parameter", "environment"]}
    for name, (dimensions, values) in model.scales(points).items():
        posterior[name] = by_chain(values, *values.shape[1:])
        dims[name] = list(dimensions)
    predictive = {"new_user": by_chain(scale.native(users), *grid)}
    dims["new_user"] = ["parameter", "environment"]
    tree = arviz_base.from_dict(
        {
            "posterior": posterior,
            "posterior_predictive": predictive,
            "sample_stats": {"lp": by_chain(model(points))},
        },
        coords={
            "parameter": parameters,
            "environment": environments,
            "cell": [f"{p} in {e}" for p, e in cells],
        },
        dims=dims,
    )
    # Time stamps would make equal runs differ.
    for node in tree.subtree:
        node.attrs.pop("created_at", None)
    return tree
