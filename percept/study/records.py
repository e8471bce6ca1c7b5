"""What was read, how it was sampled and what made it, as records of `percept.results`."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib import metadata
from pathlib import PurePath
from typing import TYPE_CHECKING

from percept import results
from percept.results import (
    Diagnostics,
    GateVerdict,
    LeftOutRow,
    Note,
    Prior,
    Provenance,
    SourceFile,
    Words,
    plain,
)
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.records import Notice
from percept.study.basics import known
from percept.study.data import Data

if TYPE_CHECKING:
    from percept.study.fit import Fit


#: Libraries whose versions decide the last digits of a result.
_PACKAGES = ("numpy", "scipy", "pandas", "emcee", "arviz-base", "arviz-stats")


def what_was_read(data: Data) -> results.Data:
    """Say what was read: subjects, quantities, notices, and every cell's values."""
    sessions = data.sessions
    factors = sessions.factors
    exclusions = []
    for row in sessions.exclusions:
        exclusions.append(LeftOutRow(row.who, row.what, row.why, _name(row.file), row.row))
    return results.Data(
        form=sessions.form,
        simulated=sessions.simulated,
        subjects=len(sessions.subjects),
        rows=len(sessions.table),
        environments=sessions.environments,
        references=len(factors.environments if factors else sessions.environments),
        factor=factors.name if factors else None,
        parameters=sessions.parameters,
        quantities={name: sessions.quantities[name] for name in sessions.parameters},
        words=_words(data),
        counts=dict(sessions.counts),
        notices=_notes(sessions.notices),
        doubts=_notes(sessions.warnings),
        exclusions=tuple(exclusions),
        design=data.design_counts,
        cells=data.values_by_cell,
        people=data.people,
    )


def _words(data: Data) -> Words:
    """Return the study's words; without a reference people give values unless the scene says."""
    scene = data.scene
    quantities = [data.sessions.quantities[name] for name in data.sessions.parameters]
    verb = scene.study.verb
    if verb == "set" and not any(quantity.is_matched for quantity in quantities):
        verb = "gave"
    return Words(*scene.environment_noun, *scene.study.subject, *scene.user_noun, verb)


def _notes(notices: Iterable[Notice]) -> tuple[Note, ...]:
    return tuple(Note(notice.text, _name(notice.file), notice.row) for notice in notices)


def _name(file: str | None) -> str | None:
    """Return a file's name without its folders, which are nobody else's business."""
    return PurePath(file).name if file else None


def provenance_of(sessions: Sessions, scene: Scene) -> Provenance:
    """Say what the results were made from: versions, seed, files and scene."""
    import percept

    versions = {"percept": percept.__version__, "python": platform.python_version()}
    versions |= {package: metadata.version(package) for package in _PACKAGES}
    files = []
    for source in sessions.sources:
        files.append(SourceFile(PurePath(source.name).name, source.sha256, source.rows))
    return Provenance(versions, scene.inference.seed, tuple(files), plain(scene.to_dict()))


def diagnostics_of(fit: Fit | None) -> Diagnostics | None:
    """Say how the fit was sampled, and which priors were in force; None without a fit."""
    if fit is None:
        return None
    from percept.inference.model.priors import MEANINGS

    priors = fit.model.priors_in_force
    ensembles, _, walkers, dimension = fit.run.points.shape
    gate = dict(vars(fit.run.gate))
    for name, value in list(gate.items()):
        # A run too short for a measure leaves it unknown.
        gate[name] = known(value) if isinstance(value, float) else value
    return Diagnostics(
        gate=GateVerdict(**gate),
        steps=fit.run.steps,
        ensembles=ensembles,
        walkers=walkers,
        dimension=dimension,
        tolerance=fit.run.settings.tolerance,
        priors=tuple(Prior(name, value, MEANINGS[name]) for name, value in priors.items()),
    )
