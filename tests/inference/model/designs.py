"""Studies of every kind that the model must handle, small and simulated, and their models."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from percept.inference.model.design import Cells, Factors, Options, design_of
from percept.inference.model.model import LinearModel
from percept.inference.model.priors import Priors
from percept.inference.model.statistics import Resolution, from_trials
from percept.inference.model.trials import by_subject
from tests.inference.twin import Study, Twin

HAND = {"hand": ("left", "right")}
LOAD = {"load": ("low", "high")}
GRIP = {"grip": ("pinch", "palm", "key")}
GROUP = {"group": ("novice", "expert")}

#: Priors that are not the defaults.
OTHER = Priors(
    alpha_sd=2.0,
    gamma_sd=0.4,
    tau_scale=0.2,
    sigma_u_scale=0.9,
    sigma_trend_scale=0.1,
    log_s_mean=-1.0,
    log_s_sd=0.6,
    kappa_sd=0.3,
    omega_scale=0.7,
    rho_shape=3.5,
    log_s_e_mean=-3.0,
    log_s_e_sd=0.8,
    kappa_e_sd=0.2,
    omega_e_scale=0.4,
)

#: Levels, between-subject factors, terms and options of each design.
DESIGNS: dict[str, dict[str, Any]] = {
    "plain": {},
    "one quantity": {"parameters": ("k",)},
    "plain, trials": {"trials": 3},
    "plain, unequal trials": {"trials": (1, 4)},
    "plain, missing cells": {"missing": 4, "subjects": 6},
    "two subjects": {"subjects": 2, "trials": 2},
    "one cell": {"environments": 1},
    "one cell, unequal trials": {"environments": 1, "trials": (1, 4)},
    "one cell, covariate": {"environments": 1, "trials": 2, "covariates": ("order",)},
    "weber": {"trials": 2, "options": {"weber": True}},
    "common spread": {"trials": 2, "options": {"common_spread": True}},
    "common spread of a constant share": {"options": {"common_spread": True, "weber": True}},
    "no subject effect": {"options": {"subject_effect": False}},
    "no subject effect, missing cells": {
        "options": {"subject_effect": False},
        "missing": 4,
        "trials": (1, 3),
    },
    "resolution": {"trials": (1, 4), "resolution": (3e-3, 1e-3)},
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

    study: Study
    model: LinearModel

    def twin(self, points: np.ndarray) -> Twin:
        """Write the model out at coordinates (W, d)."""
        return Twin(self.study, self.model.priors, self.model.scales(points))

    def points(self, count: int = 4, spread: float = 0.7) -> np.ndarray:
        """Draw coordinates (W, d)."""
        size = (count, len(self.model.names))
        return np.random.default_rng(2).normal(0.0, spread, size)


def made(name: str, seed: int = 0, priors: Priors | None = None, **changes: Any) -> Made:
    """Simulate a named design; the responses matter little to a density."""
    asked = {**DESIGNS[name], **changes}
    rng = np.random.default_rng(seed)
    parameters = asked.get("parameters", ("k", "b"))
    subjects = asked.get("subjects", 5)
    references = np.array([10.0, 1e3, 2e4])[: asked.get("environments", 3)]
    levels = {**asked.get("within", {}), **asked.get("between", {})}
    grid = [(j,) for j in range(len(references))]
    for names in levels.values():
        grid = [(*cell, level) for cell in grid for level in range(len(names))]
    places = np.array(grid)
    terms = [(factor,) for factor in levels]
    if asked.get("terms") == "hand*load":
        terms.append(("hand", "load"))
    logs = np.log10(references) - np.log10(references).mean()
    scale = 1.0 + 0.3 * np.arange(len(parameters))
    subject, cell = trials_of(asked, rng, subjects, places, levels)
    names = asked.get("covariates", ())
    response = rng.normal(0.1, 0.3, (len(cell), len(parameters)))
    if "cv" in asked:
        # Settings scatter by next to nothing about locations, between subjects and trials alike.
        shape = (len(places), len(parameters))
        between = rng.normal(0.0, 0.3, (subjects, *shape))[subject, cell]
        locations = rng.normal(0.0, 0.2, shape)[cell]
        response = locations + np.array(asked["cv"]) * (between + response)
    values = rng.normal(0.0, 1.0, (len(cell), len(names)))
    if "age" in names:
        values[:, names.index("age")] = rng.normal(0.0, 1.0, subjects)[subject]
    within = tuple(name for name in names if name != "age")
    for name in within:
        column = values[:, names.index(name)]
        column -= (np.bincount(subject, column) / np.bincount(subject))[subject]
    study = Study(
        response=response,
        subject=subject,
        cell=cell,
        environment=places[:, 0],
        x=np.outer(scale, logs[places[:, 0]]),
        levels={name: (len(levels[name]), places[:, 1 + f]) for f, name in enumerate(levels)},
        terms=tuple(terms),
        between=tuple(asked.get("between", ())),
        spread=asked.get("spread", ()),
        slopes=asked.get("slopes", False),
        covariates=values,
        own_slopes={name: names.index(name) for name in within},
        resolution=asked.get("resolution", (0.0, 0.0)),
    )
    options = Options(**asked.get("options", {}))
    model = model_of(study, parameters, levels, names, options, priors, own=asked.get("own", False))
    return Made(study, model)


def model_of(
    study: Study,
    parameters: tuple[str, ...],
    levels: dict[str, tuple[str, ...]],
    covariates: tuple[str, ...],
    options: Options,
    priors: Priors | None,
    *,
    own: bool,
) -> LinearModel:
    """Build the model of a study."""
    priors = priors or Priors()
    cells = Cells(
        names=tuple(f"C{c}" for c in range(len(study.environment))),
        environment=study.environment,
        environments=tuple(f"VE{j + 1}" for j in range(study.environment.max() + 1)),
        x=study.x,
    )
    factors = Factors(
        levels=levels,
        level={name: level for name, (_, level) in study.levels.items()},
        terms=study.terms,
        between_subjects=frozenset(study.between),
        spread=study.spread,
        subject_trends=study.slopes,
    )
    at = (study.subject, study.cell)
    statistics = from_trials(
        study.response,
        *at,
        study.x,
        parameters=parameters,
        environments=cells.names,
        subjects=tuple(f"S{i}" for i in range(study.subject.max() + 1)),
    )
    if own or covariates:
        statistics = by_subject(
            statistics,
            (study.response, *at),
            own_trial_sds=own,
            covariates=covariates,
            values=study.covariates if covariates else None,
        )
    resolution = None
    if any(study.resolution):
        between, trial = study.resolution
        resolution = Resolution(np.full(study.x.shape, between), np.full(study.x.shape, trial))
    design = design_of(cells, factors, priors, options)
    return LinearModel(statistics, design, priors, resolution)


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
