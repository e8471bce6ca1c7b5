"""Small simulated studies for the model checks, and their fits."""

from __future__ import annotations

import numpy as np

from percept import Scene, Study
from percept.simulate import Design, Hyperparameters, draw_environments, simulate
from tests.fits import SHARED

REFERENCES = {"k": [100.0, 1e3, 1e4], "b": [1.0, 5.0, 25.0]}


def hyperparameters(count: int, **changes: float) -> Hyperparameters:
    """Moderate true values, equal for every parameter."""
    values = {
        "alpha": 0.1,
        "gamma": 0.0,
        "tau": 0.1,
        "sigma_u": 0.08,
        "s": 0.15,
        "kappa": 0.0,
        "omega": 0.0,
    }
    values |= dict.fromkeys(("s_e", "kappa_e", "omega_e"), 0.0) | changes
    arrays = {
        name: np.full(count, value) for name, value in values.items() if not name.startswith("rho")
    }
    return Hyperparameters(
        **arrays, rho_u=changes.get("rho_u", 0.0), rho_w=changes.get("rho_w", 0.0), rho_e=0.0
    )


def table_of(parameters=("k",), subjects=10, references=None, seed=1, **changes):
    """Sessions as a table, one trial per cell."""
    found = references or [REFERENCES[p] for p in parameters]
    design = Design(
        np.array(found).T, np.ones((subjects, len(found[0])), dtype=int), parameters=parameters
    )
    rng = np.random.default_rng(seed)
    return simulate(
        draw_environments(hyperparameters(len(parameters), **changes), design, rng), design, rng
    )


def study_of(table, *, model=None, checks=None, **inference) -> Study:
    asked = {"method": "bayesian", "tolerance": 0.05, "seed": 7, "parameters": None, **inference}
    tables = {"inference": {k: v for k, v in asked.items() if v is not None}, "model": model or {}}
    if checks is not None:
        tables["checks"] = checks
    return Study(table, Scene(**tables), store=SHARED)
