"""What a study leaves out, and why."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from percept.errors import counted
from percept.haptics import TabulatedDevice
from percept.haptics.search import covers_range
from percept.study.classical import FAMILIES, cell_moments
from percept.study.placed import FEWEST, banded
from percept.study.units import NAMES

if TYPE_CHECKING:
    from percept.study.responses import Trials
    from percept.study.study import Study

Reason = tuple[str, str]
#: What a covariance of k and b needs.
_FEWEST_SUBJECTS = 3


def skipped(study: Study) -> Iterator[Reason]:
    """List what the data or the scene leave no room for."""
    yield from _inference(study)
    yield from _haptics(study)
    table = study.scene.frequency
    for name, (lower, upper) in study.scene.report.zoom.items():
        if name not in study.environments:
            yield f"zoom window of {name}", "no environment has this name"
        elif not max(lower, table.lower) < min(upper, table.upper):
            yield f"zoom window of {name}", f"it lies outside {table.lower:g} to {table.upper:g} rad/s"
    if len(study.environments) == 1:
        yield "trend over environments and band law", "there is one environment"
    if study.sessions.form == "summary":
        yield "subject effects and k-b correlation", "published limits do not hold them"
    if len(study.parameters) == 2:
        yield from _curves(study)
    if study.scene.inference.method != "bayesian":
        for family in FAMILIES:
            for cell in cell_moments(study.sessions, study.parameters, family):
                if cell.moments is None:
                    where = f"{NAMES[cell.parameter]} in {cell.environment}"
                    yield f"classical {family} intervals of {where}", cell.why


def _inference(study: Study) -> Iterator[Reason]:
    if study.scene.inference.method == "classical":
        yield "hierarchical model", "only the classical method was asked for"
        return
    fit = study.fit
    if fit is not None and not fit.run.gate.passed:
        yield "Bayesian intervals", " ".join(fit.run.gate.reasons)
    if fit is not None and fit.prepared.trials is not None and fit.prepared.trials.dropped:
        yield from _dropped(study, fit.prepared.trials)
    if fit is not None and fit.run.gate.passed and len(study.parameters) == 2:
        yield (
            "Bayesian intervals of k and b widened to hold together (bonferroni)",
            "only limits held to the tolerance are listed",
        )
    if study.scene.checks is not None and (study.sessions.form == "summary" or _unpooled(study)):
        yield "checks of the model", "they need the sessions of subjects, pooled over environments"


def _dropped(study: Study, trials: Trials) -> Iterator[Reason]:
    """Trials the pair of parameters leaves out, and environments it leaves without any."""
    lacking = " or ".join(NAMES[p] for p in study.parameters)
    lack = "it lacks" if trials.dropped == 1 else "they lack"
    yield f"{counted(trials.dropped, 'trial')}, in the hierarchical model", f"{lack} {lacking}"
    for environment in study.environments:
        if environment not in trials.environments:
            what = "both parameters" if len(study.parameters) == 2 else lacking
            yield f"Bayesian intervals of {environment}", f"no trial there has {what}"


def _unpooled(study: Study) -> bool:
    return study.scene.model.pooling == "none"


def _haptics(study: Study) -> Iterator[Reason]:
    if len(study.parameters) == 1:
        yield "boundaries and band", f"only {NAMES[study.parameters[0]]} was adjusted"
    elif study.device is None:
        yield "boundaries of Z_h", "the scene has no [device]"
    else:
        yield from _devices(study)
    if study.scene.coupling is None:
        yield "coupling: Z_h_vc, stability and admissible couplings", "the scene has no [coupling]"
    elif study.device is None:
        yield "coupling: Z_h_vc and stability", "the scene has no [device]"


def _devices(study: Study) -> Iterator[Reason]:
    """Other couplings, and other devices."""
    table, device, asked = study.scene.device, study.device, study.scene.inference
    assert table is not None
    assert device is not None
    if study.scene.coupling is None:
        pass
    elif not covers_range(device, table.period):
        assert isinstance(device, TabulatedDevice)
        covered = f"{device.omega[0]:g} to {device.omega[-1]:g} rad/s"
        yield (
            "admissible couplings",
            f"the device's table covers {covered}, and stability needs all of 0 to {np.pi / table.period:g}",
        )
    elif "user" not in asked.kinds:
        yield "admissible couplings", "they are judged by intervals of kind user, which were not asked for"
    if table.response is not None:
        yield "sensitivity to the device's mass and damping", "a measured response has neither"
    elif asked.method == "bayesian":
        yield "sensitivity to the device's mass and damping", "it is worked out for classical intervals"


def _curves(study: Study) -> Iterator[Reason]:
    for environment in study.environments:
        if environment not in study.placed:
            names = [NAMES[p] for p in study.parameters if not np.isfinite(study.reference[p, environment])]
            yield f"boundaries and band of {environment}", f"it has no reference {' and '.join(names)}"
    yield from _bands(study)
    asked = study.scene.inference
    share = "share" in asked.kinds
    if share:
        yield "ellipse of kind share", "there is no exact ellipse of a share of users"
    if asked.method != "classical" and share and len(study.environments) >= FEWEST:
        yield "Bayesian band law, kind share", "no posterior draw has a band of its own that holds a share"
    if share and study.device is not None:
        yield "curves through draws, kind share", "a share of users has no curve of its own"
    if study.sessions.form == "summary":
        yield "ellipses and curves through draws", "published limits hold no correlation of k and b"
        return
    if study.device is not None and (asked.method != "bayesian" or not _unpooled(study)):
        yield (
            "simultaneous bands through draws",
            "a band symmetric in logs does not suit skewed draws: it can lie inside the pointwise band",
        )
    if asked.method != "classical" and _unpooled(study):
        yield (
            "Bayesian ellipses and curves through draws",
            "cells without pooling hold no correlation of k and b",
        )
    if asked.method != "bayesian":
        both = study.sessions.table.dropna(subset=["k_adj", "b_adj"])
        for name, count in both.groupby("environment", sort=False)["subject"].nunique().items():
            if count < _FEWEST_SUBJECTS:
                what = f"classical ellipses and curves through draws of {name}"
                yield what, f"they need {_FEWEST_SUBJECTS} subjects with both parameters; there are {count}"


def _bands(study: Study) -> Iterator[Reason]:
    with_band = banded(study.reference, study.placed, study.scene.frequency.read_at)
    for environment in study.placed:
        if environment not in with_band:
            yield f"band of {environment}", "the impedance of its reference is zero"
    if len(study.environments) > 1 and len(with_band) < FEWEST:
        yield "band law", f"it needs {FEWEST} environments whose impedance is not zero"
