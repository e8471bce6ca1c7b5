"""What a study leaves out, and why."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from percept.study.classical import FAMILIES, cell_moments
from percept.study.units import NAMES

if TYPE_CHECKING:
    from percept.study.study import Study

__all__ = ["skipped"]

Reason = tuple[str, str]


def skipped(study: Study) -> Iterator[Reason]:
    """List what the data or the scene leave no room for.

    Parameters
    ----------
    study : Study
        Fitted now, unless only the classical method is asked for.

    Yields
    ------
    what, why : str
        In words.
    """
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
    elif study.fit is not None and not study.fit.run.gate.passed:
        yield "Bayesian intervals", " ".join(study.fit.run.gate.reasons)


def _haptics(study: Study) -> Iterator[Reason]:
    if len(study.parameters) == 1:
        yield "boundaries and band", f"only {NAMES[study.parameters[0]]} was adjusted"
    elif study.device is None:
        yield "boundaries of Z_h", "the scene has no [device]"
    if study.scene.coupling is None:
        yield "coupling: Z_h_vc and stability", "the scene has no [coupling]"
    elif study.device is None:
        yield "coupling: Z_h_vc and stability", "the scene has no [device]"


def _curves(study: Study) -> Iterator[Reason]:
    yield "ellipse of kind share", "there is no exact ellipse of a share of users"
    asked = study.scene.inference
    if asked.method != "classical" and "share" in asked.kinds and len(study.environments) > 2:
        yield "Bayesian band law, kind share", "no posterior draw has a band of its own that holds a share"
    if study.device is not None:
        yield "curves through draws, kind share", "a share of users has no curve of its own"
        if study.sessions.form == "summary":
            yield "ellipses and curves through draws", "published limits hold no correlation of k and b"
