"""Realism of what a study's device displays, by posterior draws of the population of users."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept import haptics
from percept.boundary.realism import Displayed, Populations, Realism, realism
from percept.scene import Scene
from percept.study.apparatus import Apparatus
from percept.study.posterior import thinned_points
from percept.study.streams import Stream, generator

if TYPE_CHECKING:
    from percept.study.bayesian import Fit

__all__ = ["populations", "study_realism"]

Array = NDArray[np.float64]


def populations(fit: Fit, scene: Scene) -> dict[str, Populations]:
    """Limits between which the level of all users lie, per posterior draw and environment.

    Parameters
    ----------
    fit : Fit
        A sampled posterior of both parameters.
    scene : Scene
        Level and seed.

    Returns
    -------
    dict of str to Populations
        N/m and N·s/m.
    """
    model, scale = fit.prepared.model, fit.prepared.scale
    points, _ = thinned_points(fit)
    rng = generator(scene.inference.seed, Stream.REALISM)
    means, _ = model.draw(points, rng)
    reach = -special.ndtri(0.5 * (1.0 - scene.inference.level)) * model.laws(points).spread
    lower, upper = scale.native(means - reach), scale.native(means + reach)
    column = {cell: c for c, cell in enumerate(model.cells)}

    def limits(parameter: str, environment: str) -> tuple[Array, Array]:
        c = column[parameter, environment]
        return lower[:, c], upper[:, c]

    return {e: Populations(limits("k", e), limits("b", e)) for e in dict.fromkeys(e for _, e in model.cells)}


def study_realism(
    apparatus: Apparatus, fit: Fit, scene: Scene, omega: Array
) -> Iterator[tuple[str, bool, Realism]]:
    """Judge every reference, without and through the coupling.

    Parameters
    ----------
    apparatus : Apparatus
        Device, references and coupling.
    fit : Fit
        A sampled posterior of both parameters.
    scene : Scene
        Level and seed.
    omega : ndarray, shape (M,)
        rad/s.

    Yields
    ------
    environment : str
    coupled : bool
    realism : Realism
    """
    for environment, users in populations(fit, scene).items():
        reference = apparatus.references[environment]
        direct = (np.full(omega.shape, float(value)) for value in (reference.stiffness, reference.damping))
        displayed = [Displayed(omega, apparatus.curve(environment, omega, coupled=False), *direct)]
        if apparatus.coupling is not None:
            shown = haptics.effective_impedance(omega, reference, apparatus.coupling, apparatus.period)
            curve = apparatus.curve(environment, omega, coupled=True)
            displayed.append(Displayed(omega, curve, shown.stiffness, shown.damping))
        judged = realism(displayed, users, apparatus.device, apparatus.period, hold=apparatus.hold)
        for coupled, found in zip((False, True), judged, strict=False):
            yield environment, coupled, found
