"""What a study computed, put into the records of `percept.results`."""

from __future__ import annotations

import dataclasses
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydantic import TypeAdapter

from percept.haptics import Device
from percept.haptics.design import CouplingDesign
from percept.haptics.limits import stable_region
from percept.haptics.records import AnyDevice
from percept.results import (
    AdmissibleCouplings,
    Boundary,
    CellValues,
    Checks,
    CouplingMap,
    Data,
    DesignCounts,
    LeftOut,
    LeftOutRow,
    NormalityTest,
    Note,
    Nouns,
    PredictiveCheck,
    PriorQuantiles,
    Provenance,
    SourceFile,
    StableEdge,
    plain,
)
from percept.results.fields import Family
from percept.scene import DeviceTable, Scene
from percept.sessions import Sessions
from percept.study.intervals import adjustments, design_counts

if TYPE_CHECKING:
    from percept.study.checks import ModelChecks

__all__ = [
    "CLOSE_POINTS", "admissible_couplings", "boundaries_of", "checks_of", "data_of",
    "provenance_of", "record", "rows", "stable_edge",
]  # fmt: skip

T = TypeVar("T")

#: A column of quantiles: "q0.5" at 0.5 per cent.
_QUANTILE = re.compile(r"q[\d.]+")

#: Libraries whose versions decide the last digits of a result.
_PACKAGES = ("numpy", "scipy", "pandas", "emcee", "arviz-base", "arviz-stats")
#: Frequencies of a close view; its window is narrow, and its curves are smooth.
CLOSE_POINTS = 61
#: Points of the edge of the stable region: a line without corners on the page.
_EDGE_POINTS = 65


def data_of(sessions: Sessions, scene: Scene) -> Data:
    """Say what was read: subjects, quantities, notices, and every cell's values."""
    factor = sessions.factor
    nouns = Nouns(
        environment=scene.environment_noun, subject=scene.study.subject, user=scene.user_noun
    )
    return Data(
        form=sessions.form,
        simulated=sessions.simulated,
        subjects=len(sessions.subjects),
        rows=len(sessions.table),
        environments=sessions.environments,
        references=len(factor.environments if factor else sessions.environments),
        factor=factor.name if factor else None,
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
        design=record(DesignCounts, design_counts(sessions)),
        cells=rows(CellValues, list(adjustments(sessions))),
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


def boundaries_of(boundaries: Iterable[object]) -> tuple[Boundary, ...]:
    """Take the fields of the boundaries of a study."""
    names = [field.name for field in dataclasses.fields(Boundary)]
    return tuple(
        Boundary(**{name: getattr(boundary, name) for name in names}) for boundary in boundaries
    )


def admissible_couplings(
    designs: Mapping[str, CouplingDesign],
    environments: Sequence[str],
    family: Family,
    stable: StableEdge | None,
) -> AdmissibleCouplings | None:
    """Put together the couplings that qualify, by method, per environment and for all together."""
    maps: list[dict[str, Any]] = []
    for method, design in designs.items():
        names = (*environments, None)
        regions = (*design.each, design.common)
        couplings = [
            {
                "name": name,
                "intervals": region.intervals,
                "largest": region.largest,
                "softest": region.softest,
            }
            for name, region in zip(names, regions, strict=True)
        ]
        maps.append({"method": method, "damping": design.common.damping, "environments": couplings})
    if not maps:
        return None
    return AdmissibleCouplings(
        kind="user",
        family=family,
        stable=stable,
        maps=rows(CouplingMap, maps),
    )


def stable_edge(device: AnyDevice | None, table: DeviceTable | None) -> StableEdge | None:
    """Return the edge of what is stable; None but for a rigid device."""
    if table is None or not isinstance(device, Device) or device.modes:
        return None
    stiffness, damping = stable_region(
        float(device.damping), table.period, hold=table.hold, points=_EDGE_POINTS
    )
    return StableEdge(np.asarray(stiffness, dtype=float), np.asarray(damping, dtype=float))


def checks_of(normality: Any, model: ModelChecks | None) -> Checks | None:
    """Put the tests of normality and the checks of the hierarchical model together."""
    tests = rows(NormalityTest, normality)
    if model is None:
        return Checks(normality=tests) if tests else None
    loo = record(LeftOut, model.loo)
    assert loo is not None
    # A row per subject, environment and parameter would be most of report.json.
    outliers = tuple(cell for cell in loo.cells if cell.outlier)
    prior = []
    for row in plain(model.prior):
        quantiles = {name[1:]: row.pop(name) for name in [*row] if _QUANTILE.fullmatch(name)}
        prior.append({**row, "quantiles": quantiles})
    return Checks(
        normality=tests,
        loo=dataclasses.replace(loo, cells=outliers),
        statistics=rows(PredictiveCheck, model.statistics),
        prior=rows(PriorQuantiles, prior),
        pull=tuple(model.pull),
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
