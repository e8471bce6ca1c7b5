"""The published study and simulated ones of many shapes, as samplers take them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

import numpy as np

from percept.sessions import read_sessions
from percept.simulate import Design, Hyperparameters, draw_environments, draw_responses
from reports import dataset
from reports.studies import Observed


@dataclass(frozen=True)
class StudyDesign:
    """Subjects by environments by trials of one simulated study, and its scatter."""

    subjects: int
    environments: int
    trials: tuple[int, int]  # Fewest and most of a cell
    sigma_w: float = 0.1
    sigma_e: float = 0.1
    missing: float = 0.0  # Fraction of the cells
    parameters: tuple[Literal["k", "b"], ...] = ("k", "b")
    correlation: float = 0.3  # Of stiffness and damping at every level
    outlier: float = 1.0  # Factor on every adjustment of the first subject


def _designs() -> dict[str, StudyDesign]:
    text = resources.files("reports.benchmark").joinpath("designs.toml").read_text(encoding="utf-8")
    designs = {}
    for name, fields in tomllib.loads(text).items():
        for several in ("trials", "parameters"):
            if several in fields:
                fields[several] = tuple(fields[several])
        designs[name] = StudyDesign(**fields)
    return designs


#: By name: subjects x environments x trials, and what is not ordinary.
DESIGNS = _designs()


def simulated(design: StudyDesign, seed: int) -> Observed:
    """Simulate a study: omega 0.2, tau 0.05, sigma_u 0.1 at either parameter.

    Parameters
    ----------
    design : StudyDesign
        Its shape and scatter.
    seed : int
        Of the data.

    Returns
    -------
    Observed
        Its trials.
    """
    shape = design.subjects, design.environments
    rng = np.random.default_rng([seed, *shape])
    trials = rng.integers(design.trials[0], design.trials[1] + 1, shape)
    trials[rng.random(shape) < design.missing] = 0
    stiffness = np.geomspace(1e3, 5e4, design.environments)
    damping = np.geomspace(1.0, 50.0, design.environments)
    size = len(design.parameters)
    references = np.stack([stiffness, damping], axis=1)[:, :size]
    plan = Design(references, trials, design.parameters)

    def same(value: float) -> Any:
        return np.full(size, value)

    correlation = design.correlation if size == 2 else 0.0
    repeated = float(plan.repeated)
    hyper = Hyperparameters(
        alpha=same(0.05),
        gamma=same(0.02),
        tau=same(0.05),
        sigma_u=same(0.1),
        rho_u=correlation,
        s=same(design.sigma_w),
        omega=same(0.2),
        rho_w=correlation,
        s_e=same(design.sigma_e * repeated),
        omega_e=same(0.2 * repeated),
        rho_e=correlation,
    )
    response = draw_responses(draw_environments(hyper, plan, rng), plan, rng)
    subject, environment, _ = plan.rows()
    response[subject == 0] += np.log(design.outlier)
    return Observed(
        design.parameters,
        response,
        subject,
        environment,
        np.arange(design.environments),
        plan.decades.T,
    )


def published(parameters: tuple[str, ...]) -> Observed:
    """Return the trials of the simulated sessions like the published study."""
    table = read_sessions(dataset("hbfd_sessions.csv")).table
    _, subject = np.unique(table["subject"], return_inverse=True)
    _, first, cell = np.unique(table["environment"], return_index=True, return_inverse=True)
    reference = table[[f"{name}_ref" for name in parameters]].to_numpy(dtype=float)
    adjusted = table[[f"{name}_adj" for name in parameters]].to_numpy(dtype=float)
    decades = np.log10(reference[first])
    x = decades - decades.mean(axis=0)
    response = np.log(adjusted / reference)
    return Observed(parameters, response, subject, cell, np.arange(len(first)), x.T)
