"""What a study computed, put into the records of `percept.results`."""

from __future__ import annotations

import dataclasses
import platform
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydantic import TypeAdapter

from percept.results import (
    Band,
    Boundary,
    CellValues,
    Checks,
    ContrastRow,
    Data,
    Diagnostics,
    GateVerdict,
    IntervalRow,
    Ladder,
    LeftOutRow,
    MethodPair,
    NormalityTest,
    Note,
    Nouns,
    Prior,
    Provenance,
    Results,
    Skipped,
    SourceFile,
    plain,
)
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import results
from percept.study.intervals import adjustments, design_counts, normality_tests, with_left_out
from percept.study.people import subject_rows
from percept.study.rendering import study_zwidth

if TYPE_CHECKING:
    from percept.study.parts import Parts

__all__ = [
    "checks_of", "compute", "data_of", "diagnostics_of", "provenance_of", "record", "rows",
]  # fmt: skip

T = TypeVar("T")

#: Libraries whose versions decide the last digits of a result.
_PACKAGES = ("numpy", "scipy", "pandas", "emcee", "arviz-base", "arviz-stats")
#: Joint treatments of close views: k and b each at the level asked for, or drawn together.
_CLOSE_JOINTS = ("marginal", "joint")
#: Frequencies of a close view; its window is narrow, and its curves are smooth.
_CLOSE_POINTS = 61


def compute(
    parts: Parts, *, curves: bool, why: bool, progress: Callable[[str], None] | None
) -> Results:
    """Compute everything that a report needs, telling `progress` what comes next."""
    step = progress or _silent
    step("working out intervals")
    intervals = with_left_out(results(parts.interval_rows), parts.sessions)
    step("contrasting levels")
    contrasts = results(parts.contrast_rows)
    step("working out boundaries")
    boundaries = parts.boundaries if curves else ()
    drawn = {boundary.environment for boundary in boundaries}
    windows = {name: (low, high) for name, (low, high) in parts.zoom.items() if name in drawn}
    asked = parts.scene.inference
    close_kind = "user" if "user" in asked.kinds else asked.kinds[0]
    close: list[Boundary] = []
    for name, (low, high) in windows.items():
        omega = np.linspace(low, high, _CLOSE_POINTS)
        close += parts.boundaries_at(omega, (name,), kinds=(close_kind,), joints=_CLOSE_JOINTS)
    step("judging what can be rendered")
    coupling = parts.coupling if curves else None
    step("judging what feels real")
    verdicts = parts.verdicts if curves else ()
    step("fitting the band law")
    band = parts.band if curves else None
    step("mapping couplings")
    design = parts.coupling_map if boundaries and parts.scene.coupling else None
    step("trying other devices")
    sensitivity = parts.other_devices if curves else None
    step("comparing the methods")
    comparison = parts.comparison
    band_pairs = parts.band_pairs if curves else None
    ladder = parts.ladder if why else None
    checks = None
    if parts.scene.checks is not None:
        step("checking the model")
        checks = checks_of(normality_tests(parts.sessions, parts.parameters), parts.checks)
    skipped = list(parts.skipped if curves else parts.skipped_before_curves)
    if not curves and len(intervals):
        skipped.append(Skipped("boundaries, coupling and band law", "run percept report"))
    return Results(
        provenance=provenance_of(parts.sessions, parts.scene),
        data=data_of(parts.sessions, parts.scene),
        intervals=rows(IntervalRow, intervals),
        contrast=rows(ContrastRow, contrasts),
        anova=tuple(results(parts.by_level.tests)),
        levels=parts.by_level.levels,
        boundaries=tuple(boundaries),
        zoom=windows,
        close=tuple(close),
        verdicts=verdicts,
        rendering=parts.rendering if curves else None,
        zwidth=study_zwidth(parts.setup) if curves else None,
        coupling=coupling,
        band=record(Band, band),
        design=design,
        sensitivity=sensitivity,
        comparison=rows(MethodPair, comparison),
        band_pairs=band_pairs,
        ladder=record(Ladder, ladder),
        diagnostics=diagnostics_of(parts),
        checks=checks,
        skipped=tuple(skipped),
        psychophysics=parts.psychophysics.rows,
        pse_lines=tuple(results(parts.psychophysics.lines)),
        equivalence=tuple(results(parts.psychophysics.equivalence)),
    )


def _silent(step: str) -> None:
    """Tell nobody of a step."""


def data_of(sessions: Sessions, scene: Scene) -> Data:
    """Say what was read: subjects, quantities, notices, and every cell's values."""
    factors = sessions.factors
    nouns = Nouns(
        environment=scene.environment_noun, subject=scene.study.subject, user=scene.user_noun
    )
    return Data(
        form=sessions.form,
        simulated=sessions.simulated,
        subjects=len(sessions.subjects),
        rows=len(sessions.table),
        environments=sessions.environments,
        references=len(factors.environments if factors else sessions.environments),
        factor=factors.name if factors else None,
        parameters=sessions.parameters,
        quantities={name: sessions.quantities[name] for name in sessions.parameters},
        words=nouns,
        counts=dict(sessions.counts),
        notices=tuple(Note(note.text, _name(note.file), note.row) for note in sessions.notices),
        doubts=tuple(Note(note.text, _name(note.file), note.row) for note in sessions.warnings),
        exclusions=tuple(
            LeftOutRow(row.who, row.what, row.why, _name(row.file), row.row)
            for row in sessions.exclusions
        ),
        design=design_counts(sessions),
        cells=rows(CellValues, list(adjustments(sessions))),
        people=tuple(subject_rows(sessions, scene)),
    )


def _name(file: str | None) -> str | None:
    """Return a file's name without its folders, which are nobody else's business."""
    return PurePath(file).name if file else None


def provenance_of(sessions: Sessions, scene: Scene) -> Provenance:
    """Say what the results were made from: versions, seed, files and scene."""
    import percept

    versions = {"percept": percept.__version__, "python": platform.python_version()}
    versions |= {package: metadata.version(package) for package in _PACKAGES}
    return Provenance(
        versions=versions,
        seed=scene.inference.seed,
        files=_sources(sessions),
        scene=plain(scene.to_dict()),
    )


def _sources(sessions: Sessions) -> tuple[SourceFile, ...]:
    return tuple(
        SourceFile(PurePath(source.name).name, source.sha256, source.rows)
        for source in sessions.sources
    )


def checks_of(normality: Any, model: Checks | None) -> Checks | None:
    """Put the tests of normality and the checks of the hierarchical model together."""
    tests = rows(NormalityTest, normality)
    if model is None or model.loo is None:
        return Checks(normality=tests) if tests else None
    # A row per subject, environment and parameter would be most of report.json.
    outliers = tuple(cell for cell in model.loo.cells if cell.outlier)
    loo = dataclasses.replace(model.loo, cells=outliers)
    return dataclasses.replace(model, normality=tests, loo=loo)


def diagnostics_of(parts: Parts) -> Diagnostics | None:
    """Say how the fit was sampled, and which priors were in force; None without a fit."""
    fit = parts.fit
    if fit is None:
        return None
    from percept.inference.model.priors import MEANINGS

    priors = fit.model.priors_in_force
    ensembles, _, walkers, dimension = fit.run.points.shape
    return Diagnostics(
        gate=_reader(GateVerdict).validate_python(plain(fit.run.gate)),
        steps=fit.run.steps,
        ensembles=ensembles,
        walkers=walkers,
        dimension=dimension,
        tolerance=fit.run.settings.tolerance,
        priors=tuple(Prior(name, value, MEANINGS[name]) for name, value in priors.items()),
    )


@cache
def _reader(kind: Any) -> TypeAdapter[Any]:
    """Return what reads a record from plain values; it takes a moment to build."""
    return TypeAdapter(kind)


def record(kind: type[T], value: Any) -> T | None:
    """Read a record from what the study computed; None where it computed nothing."""
    if value is None:
        return None
    record: T = _reader(kind).validate_python(plain(value))  # type: ignore[arg-type]  # hashable
    return record


def rows(kind: type[T], table: Any) -> Any:
    """Read a record per row of a table; None where there is no table."""
    if table is None:
        return None
    return _reader(tuple[kind, ...]).validate_python(plain(table))  # type: ignore[valid-type]
