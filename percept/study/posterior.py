"""The posterior as an ArviZ DataTree, for other programs to read.

A variable goes by its name in `posterior.toml`, which has its meaning and unit, too. Until it is
put into a tree it is a pair: names of dimensions, and values with S draws first. After the draws
stand P parameters, J environments or C cells, and N subjects. A tree then has the draws as chains,
one for each ensemble of the sampler.
"""

from __future__ import annotations

import math
import tomllib
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

import percept
from percept.inference.checks.predictive import new_studies
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.priors import Named
from percept.study.basics import Array, Stream, generator
from percept.study.fit import Fit

__all__ = ["posterior_tree", "variables_of_posterior"]

#: Draws of a chain, of four: enough for plots and summaries, and a file of few megabytes.
_MOST_DRAWS = 1000
#: Fewest draws of a chain, in large studies: plots of fewer are rough.
_FEWEST_DRAWS = 100
#: Numbers of the largest variable, 8 MB: they limit the draws of large studies.
_MOST_NUMBERS = 1 << 20
#: Draws from the prior.
_PRIOR_DRAWS = 1000
#: In place of "/" in the name of a variable, where a DataTree would read a path.
_SLASH = "\N{DIVISION SLASH}"

_NAMES = resources.files("percept.study").joinpath("posterior.toml")


@cache
def variables_of_posterior() -> dict[str, dict[str, str]]:
    """Return the meaning and the unit of every variable, by name; read once."""
    return tomllib.loads(_NAMES.read_text(encoding="utf-8"))


def posterior_tree(fit: Fit, *, seed: int) -> Any:
    """Collect draws and data, one chain per ensemble.

    Parameters
    ----------
    fit : Fit
        A fit that passed.
    seed : int
        Of the draws of locations, effects, predictions and prior.

    Returns
    -------
    xarray.DataTree
        Groups posterior, posterior_predictive and sample_stats; and of one model of sessions
        log_likelihood, observed_data and prior too. `variables_of_posterior` says what
        they hold.
    """
    import xarray

    labels = _labels(fit)
    further_labels = _further_labels(fit)
    datasets = {}
    for group, named in _groups(fit, seed).items():
        variables = {}
        for name, (dimensions, values) in named.items():
            sample, by_chain = _by_chain(fit, group, values)
            variables[name] = ((*sample, *dimensions), by_chain, _attributes(name))
        dataset = xarray.Dataset(variables, attrs=_about(fit))
        coordinates: dict[str, object] = {}
        for dimension, size in dataset.sizes.items():
            name = str(dimension)
            coordinates[name] = labels.get(name, np.arange(size))
        for name, (dimension_of_labels, entries) in further_labels.items():
            if dimension_of_labels in dataset.sizes:
                coordinates[name] = (dimension_of_labels, entries)
        datasets[group] = _without_slashes(dataset.assign_coords(coordinates))
    return xarray.DataTree.from_dict(datasets)


def _groups(fit: Fit, seed: int) -> dict[str, Named]:
    """Draw every group: by name, dimensions after the draw, and values, draws first."""
    points = _thinned(fit)
    rng = generator(seed, Stream.LOCATIONS)
    means, users = fit.model.draw(points, rng)
    posterior = fit.model.scales(points)
    posterior["population_mean"] = _in_cells(fit, means)
    predicted = {"new_user": _in_cells(fit, users)}
    groups = {
        "posterior": posterior,
        "posterior_predictive": predicted,
        "sample_stats": {"lp": _named(fit.model(points))},
    }
    subjects = fit.subjects
    if not isinstance(subjects, SubjectDensity):
        return groups
    density = subjects.density
    effects = density.draw_subject_effects(points, means, rng)
    if effects is not None:
        posterior["subject_effect"] = _named(effects, "subject", "parameter")
    left_out = _left_out(subjects, points)
    groups["log_likelihood"] = {"left_out": _named(left_out, "subject")}
    studies = list(new_studies(subjects, points, rng))
    predicted["response"] = _observations(subjects, np.concatenate(studies))
    observed = density.statistics.cell_means[None]
    groups["observed_data"] = {"response": _observations(subjects, observed)}
    rng_of_prior = generator(seed, Stream.PRIOR)
    prior = density.draw_prior(_PRIOR_DRAWS, rng_of_prior)
    groups["prior"] = prior.scales
    groups["prior"]["population_mean"] = _in_cells(fit, prior.means)
    return groups


def _named(values: Array, *dimensions: str) -> tuple[tuple[str, ...], Array]:
    """Put values with the names of their dimensions after the draw."""
    return dimensions, values


def _without_slashes(dataset: Any) -> Any:
    """Rename variables and dimensions whose names hold a slash; their meanings keep it."""
    names = [str(name) for name in (*dataset.variables, *dataset.dims)]
    renamed = {name: name.replace("/", _SLASH) for name in names if "/" in name}
    return dataset.rename(renamed)


def _by_chain(fit: Fit, group: str, values: Array) -> tuple[tuple[str, ...], Array]:
    """Return the dimensions before a variable's own, and its values with them."""
    if group == "observed_data":
        return (), values[0]
    chains = 1 if group == "prior" else len(fit.run.points)
    by_chain = values.reshape(chains, -1, *values.shape[1:])
    return ("chain", "draw"), by_chain


def _attributes(name: str) -> dict[str, str]:
    """Say what a variable is, and its unit."""
    # Scales of a factor's term go by the term's name, such as "psi:hand".
    kind, _, term = name.partition(":")
    variable = variables_of_posterior()[kind]
    meaning = variable["meaning"]
    return {
        "long_name": f"{meaning}, {term}" if term else meaning,
        "units": variable["unit"],
    }


def _thinned(fit: Fit) -> Array:
    """Keep independent draws of each chain, fewer in large studies, (S, d)."""
    chains = len(fit.run.points)
    by_chain = fit.points.reshape(chains, -1, fit.points.shape[1])
    numbers_per_draw = len(fit.model.cells)
    # The largest variable has a number for every subject and cell: responses of new studies.
    if fit.trials is not None:
        numbers_per_draw *= len(fit.trials.subjects)
    affordable = _MOST_NUMBERS // (numbers_per_draw * chains)
    draws_per_chain = min(max(affordable, _FEWEST_DRAWS), _MOST_DRAWS)
    gap = _gap(by_chain.shape[1], draws_per_chain)
    thinned = by_chain[:, ::gap]
    return thinned.reshape(-1, thinned.shape[2])


def _gap(draws: int, draws_wanted: int) -> int:
    """Return the steps from one draw that is kept to the next, so that no more are kept.

    Rounded up, a gap may leave half of the draws wanted. It never leaves fewer than the fewest.
    """
    widest = max(1, draws // _FEWEST_DRAWS)
    return min(math.ceil(draws / draws_wanted), widest)


def _in_cells(fit: Fit, responses: Array) -> tuple[tuple[str, ...], Array]:
    """Lay cells (S, C) out by parameter and environment, in the quantities' units."""
    shape = (len(responses), len(fit.parameters), len(fit.environments))
    values = np.full(shape, np.nan)
    native = fit.scale.native(responses)
    # A parameter with a model of its own may lack environments that another one has.
    for c, (parameter, environment) in enumerate(fit.model.cells):
        row = fit.parameters.index(parameter)
        column = fit.environments.index(environment)
        values[:, row, column] = native[:, c]
    return ("parameter", "environment"), values


def _left_out(subjects: SubjectDensity, points: Array) -> Array:
    """Log densities of the subjects' data, each given the others' data, (S, N)."""
    log_densities = []
    for _, scales in subjects.batches(points):
        left_out = subjects.left_out(scales)
        log_densities.append(left_out.log_density)
    return np.concatenate(log_densities)


def _present(subjects: SubjectDensity) -> NDArray[np.bool_]:
    """Tell which subjects were in which environments, (N, J)."""
    finite = np.isfinite(subjects.density.statistics.cell_means)
    return np.asarray(finite.all(axis=1))


def _observations(subjects: SubjectDensity, cells: Array) -> tuple[tuple[str, ...], Array]:
    """Keep of cell means (S, N, P, J) those that were observed, (S, P, observations).

    They are most of the file, and seven digits are more than anybody reads.
    """
    present = _present(subjects)
    by_parameter = cells.transpose(0, 2, 1, 3)
    observed = by_parameter[:, :, present]
    return ("parameter", "observation"), observed.astype(np.float32)


def _about(fit: Fit) -> dict[str, str]:
    """Say who made a group, and what a response is."""
    response = "adjusted less reference, over reference or scale"
    if fit.scale.log:
        response = "log of adjusted over reference"
    return {
        "creation_library": "percept",
        "creation_library_version": percept.__version__,
        "response": response,
    }


def _labels(fit: Fit) -> dict[str, list[str]]:
    """Name the entries of dimensions."""
    return {
        "parameter": fit.parameters,
        "environment": fit.environments,
        "subject": list(fit.trials.subjects) if fit.trials else [],
        "cell": [f"{p} in {e}" for p, e in fit.model.cells],
    }


def _further_labels(fit: Fit) -> dict[str, tuple[str, list[str]]]:
    """Give further labels of dimensions: units, and where an observation was made."""
    units = [fit.quantities[name].unit for name in fit.parameters]
    labels = {"unit": ("parameter", units)}
    if isinstance(fit.subjects, SubjectDensity) and fit.trials is not None:
        subject_codes, environment_codes = np.nonzero(_present(fit.subjects))
        subjects = [fit.trials.subjects[i] for i in subject_codes]
        environments = [fit.trials.environments[j] for j in environment_codes]
        labels["observed_subject"] = ("observation", subjects)
        labels["observed_environment"] = ("observation", environments)
    return labels
