"""Simulated studies of many shapes, whose fits are timed."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass, fields
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from percept.study.prepare import Prepared


#: Fields that make a design more than subjects by environments by trials.
_NOT_PLAIN = ("factors", "covariate", "own_trial_sds")


@dataclass(frozen=True)
class StudyDesign:
    """Subjects by environments by trials of one simulated study, and the time its fit may take."""

    subjects: int
    environments: int
    trials: tuple[int, int]  # Fewest and most of a cell
    allowed: float  # s
    sigma_w: float = 0.1
    sigma_e: float = 0.1
    missing: float = 0.0  # Fraction of the cells
    parameters: tuple[Literal["k", "b"], ...] = ("k", "b")
    family: Literal["lognormal", "normal"] = "lognormal"
    correlation: float = 0.3  # Of stiffness and damping at every level
    outlier: float = 1.0  # Factor on every adjustment of the first subject
    factors: tuple[str, ...] = ()  # Each has two levels, which every subject meets
    covariate: bool = False  # A column that varies by trial
    own_trial_sds: bool = False  # Of subjects
    peer: bool = True  # Whether nutpie takes it: plain designs that fit in its time

    @property
    def plan(self) -> str:
        """A digest that tells results of different designs apart."""
        values = []
        for field in fields(self):
            value = getattr(self, field.name)
            # Studies without factors were kept before there were any others.
            if field.name not in _NOT_PLAIN or value != field.default:
                values.append(value)
        return hashlib.sha256(repr(tuple(values)).encode()).hexdigest()[:16]


def _designs() -> dict[str, StudyDesign]:
    text = resources.files("reports.benchmark").joinpath("designs.toml").read_text(encoding="utf-8")
    designs = {}
    for name, options in tomllib.loads(text).items():
        for key, value in options.items():
            if isinstance(value, list):
                options[key] = tuple(value)
        designs[name] = StudyDesign(**options)
    return designs


#: By name: subjects x environments x trials, and what is not ordinary.
DESIGNS = _designs()


def simulated(design: StudyDesign, seed: int) -> Prepared:
    """Simulate a study: omega 0.2, tau 0.05, sigma_u 0.1 at either parameter.

    Cells of factors are drawn like environments that share a reference.

    Parameters
    ----------
    design : StudyDesign
        Its shape and scatter.
    seed : int
        Of the data.

    Returns
    -------
    Prepared
        Its model, and its trials.
    """
    from percept.scene import Scene
    from percept.sessions import ReadOptions, Sessions
    from percept.simulate.model import Design, Hyperparameters, draw_environments, simulate
    from percept.study import Study
    from percept.study.prepare import prepare

    levels = 2 ** len(design.factors)
    shape = design.subjects, design.environments * levels
    rng = np.random.default_rng([seed, *shape])
    trials = rng.integers(design.trials[0], design.trials[1] + 1, shape)
    trials[rng.random(shape) < design.missing] = 0
    stiffness = np.geomspace(1e3, 5e4, design.environments)
    damping = np.geomspace(1.0, 50.0, design.environments)
    size = len(design.parameters)
    references = np.stack([stiffness, damping], axis=1)[:, :size].repeat(levels, axis=0)
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
        kappa=same(0.0),
        omega=same(0.2),
        rho_w=correlation,
        s_e=same(design.sigma_e * repeated),
        kappa_e=same(0.0),
        omega_e=same(0.2 * repeated),
        omega_s=same(0.4 * design.own_trial_sds),
        rho_e=correlation,
    )
    table = simulate(draw_environments(hyper, plan, rng), plan, rng, family=design.family)
    for name in design.parameters:
        table.loc[table["subject"] == plan.subjects[0], f"{name}_adj"] *= design.outlier
    terms = " * ".join(design.factors)
    if design.factors:
        cell = table["environment"].map({name: c for c, name in enumerate(plan.environments)})
        for number, factor in enumerate(design.factors):
            table[factor] = "level " + (cell // 2**number % 2).astype(str)
        table["environment"] = "VE" + (cell // levels).astype(str)
    if design.covariate:
        table["start"] = rng.standard_normal(len(table))
        terms += " + start"
    model: dict[str, Any] = {"subjects_trial_sd": design.own_trial_sds}
    if terms:
        model["bias"] = terms
    scene = Scene(
        inference={"family": design.family, "parameters": list(design.parameters)}, model=model
    )
    sessions = Sessions.from_frame(table, scene=ReadOptions.from_mapping(dict(scene)))
    return prepare(Study(sessions, scene).data)
