"""Study designs the model must handle, as small simulated data sets."""

from __future__ import annotations

import dataclasses

import numpy as np

from percept.inference.hierarchy.statistics import Statistics, from_trials

REFERENCES = {"k": (10.0, 1e3, 1e4, 2.5e4, 5e4), "b": (0.1, 1.0, 10.0, 25.0, 50.0)}


@dataclasses.dataclass(frozen=True)
class Study:
    response: np.ndarray
    subject: np.ndarray
    environment: np.ndarray
    x: np.ndarray
    statistics: Statistics


def study(name: str, rng: np.random.Generator) -> Study:
    """Simulated trials of a named design, at realistic spreads."""
    parameters = {"k only": ("k",), "b only": ("b",)}.get(name, ("k", "b"))
    environments = 1 if name in ("one environment", "one environment, trials") else 4
    subjects = 3 if name == "three subjects" else 6
    cells = [(i, j) for i in range(subjects) for j in range(environments)]
    if name == "missing cells":
        cells = [cell for cell in cells if cell not in {(0, 1), (2, 3), (2, 0), (5, 1)}]
    if name == "one environment each":
        cells = [(i, j) for i, j in cells if i > 1 or j == i]
    trials = dict.fromkeys(cells, 1)
    if name in ("trials", "one environment, trials"):
        trials = dict.fromkeys(cells, 3)
    if name in ("unequal trials", "many patterns"):
        trials = {cell: int(rng.integers(1, 4)) for cell in cells}
    return _simulate(parameters, environments, subjects, trials, rng)


def _simulate(parameters, environments, subjects, trials, rng):
    size = len(parameters)
    references = np.array([REFERENCES[p][:environments] for p in parameters])
    x = np.log10(references) - np.log10(references).mean(axis=1, keepdims=True)
    beta = 0.2 * rng.normal(size=(environments, size))
    u = 0.1 * rng.normal(size=(subjects, size))
    rows = []
    for (i, j), count in trials.items():
        w = 0.15 * rng.normal(size=size)
        rows += [(i, j, beta[j] + u[i] + w + 0.05 * rng.normal(size=size)) for _ in range(count)]
    order = rng.permutation(len(rows))
    subject = np.array([rows[m][0] for m in order])
    environment = np.array([rows[m][1] for m in order])
    response = np.array([rows[m][2] for m in order])
    statistics = from_trials(
        response,
        subject,
        environment,
        x,
        parameters=parameters,
        environments=tuple(f"VE{j + 1}" for j in range(environments)),
        subjects=tuple(f"S{i + 1:02d}" for i in range(subjects)),
    )
    return Study(response, subject, environment, x, statistics)


NAMES = (
    "balanced",
    "k only",
    "b only",
    "one environment",
    "one environment, trials",
    "trials",
    "unequal trials",
    "missing cells",
    "one environment each",
    "three subjects",
    "many patterns",
)
