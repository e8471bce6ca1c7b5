"""Simulated studies of many shapes, whose fits are timed."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from percept.inference.hierarchy.statistics import Statistics

__all__ = ["DESIGNS", "StudyDesign", "simulated"]


@dataclasses.dataclass(frozen=True)
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
        return hashlib.sha256(repr(dataclasses.astuple(self)).encode()).hexdigest()[:16]


_K: tuple[Literal["k"]] = ("k",)
_WEAK = 0.02  # Trials scatter five times as much as subjects
DESIGNS = {
    "6x3x1": StudyDesign(6, 3, (1, 1), 3.0),
    "12x8x1": StudyDesign(12, 8, (1, 1), 4.0),
    "24x12x1": StudyDesign(24, 12, (1, 1), 5.0),
    "24x20x1": StudyDesign(24, 20, (1, 1), 10.0),
    "6x3x3": StudyDesign(6, 3, (3, 3), 4.0),
    "12x5x3": StudyDesign(12, 5, (3, 3), 6.0),
    "12x8x5": StudyDesign(12, 8, (5, 5), 10.0),
    "24x12x3": StudyDesign(24, 12, (3, 3), 20.0),
    "6x3x3-weak": StudyDesign(6, 3, (3, 3), 4.0, sigma_w=_WEAK),
    "12x5x3-weak": StudyDesign(12, 5, (3, 3), 6.0, sigma_w=_WEAK),
    "12x8x5-weak": StudyDesign(12, 8, (5, 5), 10.0, sigma_w=_WEAK),
    "24x12x3-weak": StudyDesign(24, 12, (3, 3), 20.0, sigma_w=_WEAK),
    "24x12x3-none": StudyDesign(24, 12, (3, 3), 25.0, sigma_w=0.0, correlation=0.9),
    "40x6x10-weak": StudyDesign(40, 6, (10, 10), 15.0, sigma_w=_WEAK),
    "10x5-irregular-normal": StudyDesign(10, 5, (1, 6), 12.0, missing=0.2, family="normal"),
    "24x8-irregular": StudyDesign(24, 8, (1, 4), 30.0, missing=0.2),
    "60x8-irregular": StudyDesign(60, 8, (1, 4), 60.0, missing=0.2),
    "8x4x2-outlier": StudyDesign(8, 4, (2, 2), 8.0, outlier=3.0),
    "40x20-irregular-k": StudyDesign(40, 20, (2, 5), 60.0, parameters=_K),
    "80x15-irregular-k": StudyDesign(80, 15, (1, 4), 60.0, missing=0.2, parameters=_K),
    "315x60-irregular-k": StudyDesign(315, 60, (1, 4), 600.0, missing=0.2, parameters=_K),
    "186x60x2-k": StudyDesign(186, 60, (2, 2), 300.0, parameters=_K),
    "30x100x3": StudyDesign(30, 100, (3, 3), 600.0, peer=False),
    "20x60x1": StudyDesign(20, 60, (1, 1), 60.0),
    "20x100x1": StudyDesign(20, 100, (1, 1), 300.0),
    "30x200x1-k": StudyDesign(30, 200, (1, 1), 300.0, parameters=_K),
    "200x5x20": StudyDesign(200, 5, (20, 20), 10.0),
}


def simulated(design: StudyDesign, seed: int) -> Statistics:
    """Simulate a study: omega 0.2, tau 0.05, sigma_u 0.1 at either parameter.

    Parameters
    ----------
    design : StudyDesign
        Its shape and scatter.
    seed : int
        Of the data.

    Returns
    -------
    Statistics
        What the density reads.
    """
    from percept.scene import Scene
    from percept.sessions import Sessions
    from percept.simulate.model import Design, Hyperparameters, draw_environments, simulate
    from percept.study.fit import prepare

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
    scene = Scene(inference={"family": design.family, "parameters": list(design.parameters)})
    model: Any = prepare(Sessions.from_frame(table), scene, design.parameters).model
    return model.statistics
