"""What the methods asked for give of one study, put together: regions, draws and bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from percept.boundary.band import BandStudy
from percept.study import regions
from percept.study.band_replicates import Replicates, classical_replicates, posterior_replicates
from percept.study.bands import band_study, weber_trend
from percept.study.curve_draws import classical_draws, posterior_draws
from percept.study.placed import banded
from percept.study.regions import Draws, Region

if TYPE_CHECKING:
    from percept.study.bayesian import Fit
    from percept.study.study import Study


def study_regions(study: Study) -> tuple[Region, ...]:
    """Put together the rectangles and ellipses of (k, b) of every method, kind and joint treatment."""
    found = list(regions.rectangles(study.intervals))
    if study.scene.inference.method != "bayesian":
        found += regions.classical_ellipses(study.sessions, study.scene)
    fit = _passed(study)
    if fit is not None:
        found += regions.bonferroni_regions(fit, study.scene)
        counts = {e: int(n) for (_, e), n in zip(fit.prepared.model.cells, fit.prepared.counts, strict=True)}
        for drawn in study.curve_draws:
            if drawn.method == "bayesian":
                found += regions.draw_ellipses(drawn, counts)
    return tuple(found)


def study_draws(study: Study) -> tuple[Draws, ...]:
    """Put together the draws of (k, b) that curves go through."""
    found: list[Draws] = []
    if study.scene.inference.method != "bayesian":
        found += classical_draws(study.sessions, study.scene)
    fit = _passed(study)
    if fit is not None and study.scene.model.pooling != "none":
        found += posterior_draws(fit, study.scene)
    return tuple(found)


def study_bands(study: Study, omega: float) -> BandStudy:
    """Work out bands and their law, with intervals from the posterior and from a bootstrap."""
    level, kappa = study.scene.inference.level, None
    names = banded(study.reference, study.placed, omega)
    replicates: Replicates = {}
    if study.scene.inference.method != "bayesian":
        replicates |= classical_replicates(study.sessions, study.scene, names, omega)
    fit = _passed(study)
    if fit is not None:
        replicates |= posterior_replicates(fit, study.scene, names, omega)
        kappa = weber_trend(fit, level=level)
    return band_study(study.intervals, names, replicates, omega=omega, level=level, kappa=kappa)


def _passed(study: Study) -> Fit | None:
    fit = study.fit
    return fit if fit is not None and fit.run.gate.passed else None
