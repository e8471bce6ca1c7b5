"""Realism of what a study's device displays, by posterior draws of the population of users."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept import haptics
from percept.boundary.realism import Displayed, Populations, Realism, realism
from percept.haptics.search import dips_and_peaks, search_grid
from percept.scene import Scene
from percept.study.apparatus import Apparatus
from percept.study.posterior import thinned_points
from percept.study.streams import Stream, generator

if TYPE_CHECKING:
    from percept.study.bayesian import Fit

Array = NDArray[np.float64]
_MOST = 4096


def populations(fit: Fit, scene: Scene) -> dict[str, Populations]:
    """Limits between which the level of all users lie, per posterior draw and environment."""
    model, scale = fit.prepared.model, fit.prepared.scale
    points, _ = thinned_points(fit)
    rng = generator(scene.inference.seed, Stream.REALISM)
    means, _ = model.draw(points, rng)
    reach = -special.ndtri(0.5 * (1.0 - scene.inference.level)) * model.laws(points).population_sd
    lower, upper = scale.native(means - reach), scale.native(means + reach)
    column = {cell: c for c, cell in enumerate(model.cells)}

    def limits(parameter: str, environment: str) -> tuple[Array, Array]:
        c = column[parameter, environment]
        return lower[:, c], upper[:, c]

    return {e: Populations(limits("k", e), limits("b", e)) for e in dict.fromkeys(e for _, e in model.cells)}


def study_realism(
    apparatus: Apparatus, fit: Fit, scene: Scene, omega: Array
) -> Iterator[tuple[str, bool, Realism]]:
    """Judge every reference, without and through the coupling, at as many frequencies as it takes.

    The dips and peaks of abs(Z_h) as displayed are added to the frequencies given. All intervals are then
    halved until no probability throughout the range moves by more than its Monte Carlo error, or up to 4096
    frequencies.
    """
    for environment, users in populations(fit, scene).items():
        grid = np.union1d(omega, _turns(apparatus, environment, float(omega[0]), float(omega[-1])))
        judged = _judged(apparatus, environment, users, grid)
        while grid.size < _MOST:
            before, grid = judged, np.union1d(grid, np.sqrt(grid[:-1] * grid[1:]))
            judged = _judged(apparatus, environment, users, grid)
            if _settled(before, judged, users.stiffness[0].size):
                break
        for coupled, found in zip((False, True), judged, strict=False):
            yield environment, coupled, found


def _turns(apparatus: Apparatus, environment: str, lower: float, upper: float) -> Array:
    """Where abs(Z_h) as displayed has its dips and peaks between two frequencies, rad/s."""
    fine = search_grid(apparatus.device, apparatus.period, *apparatus.resonances(environment))
    fine = np.unique([lower, *fine[(fine > lower) & (fine < upper)], upper])
    ways = (False, True) if apparatus.coupling is not None else (False,)
    return np.concatenate(
        [dips_and_peaks(partial(apparatus.curve, environment, coupled=way), fine) for way in ways]
    )


def _judged(apparatus: Apparatus, environment: str, users: Populations, omega: Array) -> list[Realism]:
    """Judge one reference at frequencies (M,), rad/s, without and, if there is one, through the coupling."""
    reference = apparatus.references[environment]
    direct = (np.full(omega.shape, float(value)) for value in (reference.stiffness, reference.damping))
    displayed = [Displayed(omega, apparatus.curve(environment, omega, coupled=False), *direct)]
    if apparatus.coupling is not None:
        shown = haptics.effective_impedance(omega, reference, apparatus.coupling, apparatus.period)
        curve = apparatus.curve(environment, omega, coupled=True)
        displayed.append(Displayed(omega, curve, shown.stiffness, shown.damping))
    return realism(displayed, users, apparatus.device, apparatus.period, hold=apparatus.hold)


def _settled(before: list[Realism], after: list[Realism], draws: int) -> bool:
    """Say whether no probability throughout the range has moved by more than its Monte Carlo error."""
    first, second = (
        np.array([(one.magnitude_throughout, one.plane_throughout) for one in judged])
        for judged in (before, after)
    )
    # Where all draws agree the error counts as one draw.
    error = np.maximum(np.sqrt(second * (1.0 - second) / draws), 1.0 / draws)
    return bool((np.abs(first - second) <= error).all())
