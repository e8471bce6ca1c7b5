"""The posterior as a DataTree in ArviZ's groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import percept
from percept.study.basics import Array, Stream, generator
from percept.study.fit import Fit


def posterior_tree(fit: Fit, *, seed: int) -> Any:
    """Collect scales, correlations, locations and new users, one chain per ensemble."""
    import xarray

    points, grid = fit.points, (len(fit.parameters), len(fit.environments))
    means, users = fit.model.draw(points, generator(seed, Stream.LOCATIONS))
    # Parameters that are modelled apart may have other environments.
    at = [fit.parameters.index(p) * grid[1] + fit.environments.index(e) for p, e in fit.model.cells]

    def in_cells(responses: Array) -> tuple[Sequence[str], Array]:
        whole = np.full((len(points), *grid), np.nan)
        whole.reshape(len(points), -1)[:, at] = fit.scale.native(responses)
        return ("parameter", "environment"), whole

    # By group and variable: dimensions after the draw, and values (draws, ...).
    groups: dict[str, Mapping[str, tuple[Sequence[str], Array]]] = {
        "posterior": {"population_mean": in_cells(means), **fit.model.scales(points)},
        "posterior_predictive": {"new_user": in_cells(users)},
        "sample_stats": {"lp": ((), fit.model(points))},
    }
    labels = {
        "parameter": fit.parameters,
        "environment": fit.environments,
        "cell": [f"{p} in {e}" for p, e in fit.model.cells],
    }
    made_by = {"creation_library": "percept", "creation_library_version": percept.__version__}
    chains, found = len(fit.run.points), {}
    for group, named in groups.items():
        dataset = xarray.Dataset(
            {
                name: (("chain", "draw", *dims), np.reshape(values, (chains, -1, *values.shape[1:])))
                for name, (dims, values) in named.items()
            },
            attrs=made_by,
        )
        coords = {dim: labels.get(str(dim), np.arange(size)) for dim, size in dataset.sizes.items()}
        found[group] = dataset.assign_coords(coords)
    return xarray.DataTree.from_dict(found)
