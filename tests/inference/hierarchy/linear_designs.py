"""Designs with factors, groups and covariates, and their covariance over every trial written
out."""

from __future__ import annotations

import dataclasses

import numpy as np

from percept.inference.hierarchy.covariates import with_covariates
from percept.inference.hierarchy.design import Cells, Factors, design_of
from percept.inference.hierarchy.linear import LinearModel
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import apart_by_subject, from_trials
from percept.inference.hierarchy.trial_scatter import trial_scatter

HAND = {"hand": ("left", "right")}
LOAD = {"load": ("low", "high")}
GRIP = {"grip": ("pinch", "palm", "key")}
GROUP = {"group": ("novice", "expert")}

#: Levels, between-subject factors, terms and options of each design.
DESIGNS = {
    "no factor": {},
    "one quantity, two levels": {"within": HAND, "parameters": ("k",)},
    "two levels, trials": {"within": HAND, "trials": 3},
    "two by two, spread": {"within": HAND | LOAD, "terms": "hand*load", "spread": ("hand",)},
    "three levels, missing cells": {"within": GRIP, "missing": 5},
    "unequal trials": {"within": HAND, "trials": (1, 4), "spread": ("hand",)},
    "two groups": {"between": GROUP, "subjects": 6},
    "two by two, two groups, covariate": {
        "within": HAND | LOAD,
        "between": GROUP,
        "terms": "hand*load",
        "trials": (1, 3),
        "covariates": ("age",),
        "missing": 3,
    },
    "covariates of trials": {"within": HAND, "trials": 3, "covariates": ("order", "start")},
    "slopes over references": {"within": HAND, "slopes": True, "trials": 2},
    "one environment": {"within": GRIP, "environments": 1, "trials": 2},
    "subjects' trial SDs": {"within": HAND, "trials": 3, "own": True},
    "subjects' trial SDs, covariates": {
        "within": HAND,
        "between": GROUP,
        "trials": (1, 5),
        "covariates": ("order", "age"),
        "missing": 3,
        "own": True,
    },
    "one quantity, subjects' trial SDs": {"parameters": ("b",), "trials": (2, 4), "own": True},
}


@dataclasses.dataclass(frozen=True, eq=False)
class Made:
    """A simulated study and its model."""

    model: LinearModel
    response: np.ndarray  # (M, P)
    subject: np.ndarray
    cell: np.ndarray
    covariates: np.ndarray  # (M, number of covariates)


def made(name, seed=0, priors=None):
    """Simulate a named design; the responses matter little to a density."""
    asked = DESIGNS[name]
    rng = np.random.default_rng(seed)
    within = asked.get("within", {})
    between = asked.get("between", {})
    parameters = asked.get("parameters", ("k", "b"))
    subjects = asked.get("subjects", 5)
    references = np.array([10.0, 1e3, 2e4])[: asked.get("environments", 3)]
    levels = {**within, **between}
    grid = [(j,) for j in range(len(references))]
    for names in levels.values():
        grid = [(*cell, level) for cell in grid for level in range(len(names))]
    grid = np.array(grid)
    environment = grid[:, 0]
    level = {factor: grid[:, 1 + f] for f, factor in enumerate(levels)}
    terms = tuple((factor,) for factor in levels)
    if asked.get("terms") == "hand*load":
        terms = (*terms, ("hand", "load"))
    factors = Factors(
        levels=levels,
        level=level,
        terms=terms,
        between_subjects=frozenset(between),
        spread=asked.get("spread", ()),
        slopes=asked.get("slopes", False),
    )
    logs = np.log10(references) - np.log10(references).mean()
    x = np.stack([logs * (1.0 + 0.3 * p) for p in range(len(parameters))])[:, environment]
    cells = Cells(
        names=tuple("-".join(map(str, cell)) for cell in grid),
        environment=environment,
        environments=tuple(f"VE{j + 1}" for j in range(len(references))),
        x=x,
    )
    subject, cell = trials_of(asked, rng, subjects, grid, levels)
    response = rng.normal(0.1, 0.3, (len(cell), len(parameters)))
    labels = {
        "parameters": parameters,
        "environments": cells.names,
        "subjects": tuple(f"S{i}" for i in range(subjects)),
    }
    statistics = from_trials(response, subject, cell, x, **labels)
    names = asked.get("covariates", ())
    values = rng.normal(0.0, 1.0, (len(cell), len(names)))
    if "age" in names:
        values[:, names.index("age")] = rng.normal(0.0, 1.0, subjects)[subject]
    covariates = None
    scatter = None
    own = asked.get("own", False)
    if own:
        statistics = apart_by_subject(statistics)
    if names:
        pooled = trial_scatter(response, subject, cell, values, by_subject=False)
        statistics, covariates = with_covariates(values, subject, cell, names, statistics, pooled)
    if names or own:
        scatter = trial_scatter(response, subject, cell, values, by_subject=own)
    priors = priors or Priors()
    design = design_of(cells, factors, priors)
    model = LinearModel(statistics, design, priors, covariates, scatter)
    return Made(model, response, subject, cell, values)


def trials_of(asked, rng, subjects, grid, levels):
    """Subject and cell of every trial; a between-subject factor has a level for each subject."""
    pairs = [(i, c) for i in range(subjects) for c in range(len(grid))]
    for factor in asked.get("between", {}):
        column = 1 + list(levels).index(factor)
        pairs = [(i, c) for i, c in pairs if grid[c, column] == i % 2]
    gone = set(rng.permutation(len(pairs))[: asked.get("missing", 0)].tolist())
    pairs = [pair for number, pair in enumerate(pairs) if number not in gone]
    trials = asked.get("trials", 1)
    subject = []
    cell = []
    for i, c in pairs:
        count = trials if isinstance(trials, int) else int(rng.integers(*trials))
        subject += [i] * count
        cell += [c] * count
    return np.array(subject), np.array(cell)


def columns(levels):
    """Orthogonal columns that sum to zero, by Gram and Schmidt on differences from the first."""
    basis = []
    for k in range(1, levels):
        vector = np.zeros(levels)
        vector[:k] = -1.0
        vector[k] = k
        basis.append(vector / np.sqrt(2.0 * vector @ vector))
    return np.array(basis)


def dense(made, named, s):
    """Covariance of all trials (quantity by quantity) for set `s` of named scales, and its
    parts."""
    model = made.model
    design = model.design
    priors = model.priors
    size = design.parameters
    cells = design.cells
    count = len(cells.names)
    value = {name: array[..., s] for name, array in named.items()}
    block = np.zeros((size, count, size, count))
    same = cells.environment[:, None] == cells.environment
    for term in design.fixed:
        for p in range(size):
            block[p, :, p] += np.einsum("kc,kd->cd", term.columns[:, p], term.columns[:, p])
    for term in design.deviation:
        tau = value["tau" if term.name == "level" else f"tau:{term.name}"]
        for p in range(size):
            product = np.einsum("kc,kd->cd", term.columns[:, p], term.columns[:, p])
            block[p, :, p] += tau[p] ** 2 * same * product
    stretch = np.ones((size, count))
    for term in design.effect_size:
        eta = value[f"eta:{term.name}"] / priors.psi_sd
        stretch = stretch * np.exp(np.einsum("kpc,pk->pc", term.columns, eta))
    user = np.zeros_like(block)
    for term in design.subject:
        usual = term.name == "level"
        sd = value["sigma_u" if usual else f"sigma_v:{term.name}"]
        rho = value.get("rho_u" if usual else f"rho_v:{term.name}", 0.0)
        for p in range(size):
            for q in range(size):
                scale = sd[p] * sd[q] * (1.0 if p == q else rho)
                product = np.einsum("kc,kd->cd", term.columns[:, p], term.columns[:, q])
                user[p, :, q] += scale * product * np.outer(stretch[p], stretch[q])
    for p in range(size):
        for q in range(size):
            rho = 1.0 if p == q else value["rho_w"]
            user[p, :, q] += np.diag(rho * value["sigma"][p] * value["sigma"][q])
    trials = len(made.cell)
    total = np.zeros((size, trials, size, trials))
    together = made.subject[:, None] == made.subject
    for p in range(size):
        for q in range(size):
            at = np.ix_(made.cell, made.cell)
            total[p, :, q] += block[p, :, q][at] + together * user[p, :, q][at]
            if "sigma_e" in value:
                rho = 1.0 if p == q else value["rho_e"]
                sd = rho * value["sigma_e"][p] * value["sigma_e"][q]
                if "phi" in value:
                    ratio = np.exp(value["phi"][p] + value["phi"][q])
                    total[p, :, q] += np.diag(sd[made.cell] * ratio[made.subject])
                else:
                    total[p, :, q] += np.diag(sd[made.cell])
        slopes = priors.covariate_sd**2 * made.covariates @ made.covariates.T
        total[p, :, p] += slopes
    flat = total.reshape(size * trials, -1)
    return flat, block.reshape(size * count, -1), user.reshape(size * count, -1)
