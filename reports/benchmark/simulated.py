"""Simulated studies of many shapes, whose fits are timed."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import astuple, dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from percept.inference.model.statistics import Statistics
    from percept.study.prepare import Prepared
    from reports.peers import Observed


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
    peer: bool = True  # Whether nutpie's compilation and sampling fit in its time

    @property
    def plan(self) -> str:
        """A digest that tells results of different designs apart."""
        return hashlib.sha256(repr(astuple(self)).encode()).hexdigest()[:16]


def _designs() -> dict[str, StudyDesign]:
    text = resources.files("reports.benchmark").joinpath("designs.toml").read_text(encoding="utf-8")
    designs = {}
    for name, fields in tomllib.loads(text).items():
        fields["trials"] = tuple(fields["trials"])
        if "parameters" in fields:
            fields["parameters"] = tuple(fields["parameters"])
        designs[name] = StudyDesign(**fields)
    return designs


#: By name: subjects x environments x trials, and what is not ordinary.
DESIGNS = _designs()


def simulated(design: StudyDesign, seed: int) -> Prepared:
    """Simulate a study: omega 0.2, tau 0.05, sigma_u 0.1 at either parameter.

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
    from percept.sessions import Sessions
    from percept.simulate.model import Design, Hyperparameters, draw_environments, simulate
    from percept.study.data import Data
    from percept.study.prepare import prepare

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
        kappa=same(0.0),
        omega=same(0.2),
        rho_w=correlation,
        s_e=same(design.sigma_e * repeated),
        kappa_e=same(0.0),
        omega_e=same(0.2 * repeated),
        rho_e=correlation,
    )
    table = simulate(draw_environments(hyper, plan, rng), plan, rng, family=design.family)
    of_outlier = table["subject"] == plan.subjects[0]
    for name in design.parameters:
        table.loc[of_outlier, f"{name}_adj"] *= design.outlier
    scene = Scene(
        inference={"family": design.family, "parameters": list(design.parameters)},
        # These studies are fitted by the model in which subjects share one trial SD.
        model={"subjects_trial_sd": False},
    )
    return prepare(Data(Sessions.from_frame(table), scene))


def statistics_of(study: Prepared) -> Statistics:
    """Return what the density reads of a study."""
    assert study.trials is not None
    return study.trials.statistics


def observed(study: Prepared) -> Observed:
    """Return a study of the published kind as the plainly written model takes it."""
    from percept.inference.model.priors import Priors
    from reports.peers import Observed

    data = study.trials
    assert data is not None
    return Observed(
        data.response,
        data.subject,
        data.environment,
        np.arange(len(data.environments)),
        data.statistics.x,
        Priors(),
    )
