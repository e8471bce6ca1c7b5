"""The document of a report: everything a study found, as report.json holds it."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from percept.haptics import Device
from percept.haptics.limits import stable_region
from percept.report.overview import findings
from percept.report.select import EACH_BY_ITSELF, distinct
from percept.results.plain import plain
from percept.study.intervals import adjustments, design_counts, normality_tests

if TYPE_CHECKING:
    from percept.study import Study

SCHEMA = "percept-report/1"

_PACKAGES = ("numpy", "scipy", "pandas", "emcee", "arviz-base", "arviz-stats")
_CLOSE_POINTS = 61
_REPORT_ALONE = "only percept report has them"
_EDGE_POINTS = 65  # of the stable region


def build_document(
    study: Study,
    *,
    curves: bool = True,
    why: bool = False,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Build the document that the page, the tables and the figures are made from.

    Parameters
    ----------
    study : Study
        What it has not computed yet is computed now.
    curves : bool
        Whether boundaries, the coupling judged by them and the band law are wanted; else they are
        absent.
    why : bool
        Whether the reasons why the methods differ are wanted: ``ladder``, else None.
    progress : callable, optional
        Called with the name of each step.

    Returns
    -------
    dict
        ``schema``, ``provenance``, ``data``, ``intervals``, ``contrast``, ``boundaries`` with their
        ``zoom`` windows, and ``close`` views, ``passivity``, ``coupling``, ``band``, ``design``,
        ``sensitivity``, ``comparison``, ``ladder``, ``diagnostics``, ``checks``, ``skipped``, and
        what is worked out from them: ``summary``. JSON values only (see `percept.results.plain`), in
        the units of the tables: units of the quantities, and N/m, N·s/m, rad/s, kg, s. No run
        times, no folders.
    """
    step = progress or (lambda _: None)
    step("intervals")
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "provenance": provenance(study),
        "data": data_of(study),
        "intervals": plain(study.intervals.assign(covers=study.interpretation["covers"])),
    }
    step("contrasts")
    document["contrast"] = plain(study.contrasts)
    step("boundaries")
    boundaries = plain(study.boundaries) if curves else []
    shown = distinct(boundaries, "environment")
    windows = {name: window for name, window in study.zoom.items() if name in shown}
    document |= {
        "boundaries": boundaries,
        "zoom": windows,
        "close": _close_views(study, windows),
        "passivity": plain(study.passivity) if curves else None,
    }
    step("coupling")
    document["coupling"] = plain(study.coupling) if curves else None
    step("band law")
    document["band"] = plain(study.band) if curves else None
    step("admissible couplings")
    wanted = boundaries and study.scene.coupling
    document["design"] = design_of(study) if wanted else None
    step("sensitivity to the device")
    document["sensitivity"] = plain(study.sensitivity) if curves else None
    step("comparison of methods")
    document["comparison"] = plain(study.comparison)
    document["ladder"] = plain(study.ladder) if why else None
    document["diagnostics"] = plain(study.diagnostics)
    step("checks of the model")
    document["checks"] = _checks(study)
    skipped = study.skipped if curves else study.skipped_before_curves
    document["skipped"] = [{"what": what, "why": why} for what, why in skipped]
    if not curves and len(study.intervals):
        document["skipped"].append(
            {"what": "boundaries, coupling and band law", "why": _REPORT_ALONE}
        )
    return document | {"summary": findings(document)}


def provenance(study: Study) -> dict[str, Any]:
    """Say what a result was made from: versions, seed, files and scene."""
    import percept

    return {
        "versions": (
            {"percept": percept.__version__, "python": platform.python_version()}
            | {package: metadata.version(package) for package in _PACKAGES}
        ),
        "seed": study.scene.inference.seed,
        "files": [
            {"name": PurePath(source.name).name, "sha256": source.sha256, "rows": source.rows}
            for source in study.sessions.sources
        ],
        "scene": plain(study.scene.to_dict()),
    }


def data_of(study: Study) -> dict[str, Any]:
    """Say what was read: subjects, quantities, notices, and every cell's values."""
    sessions = study.sessions
    return {
        "form": sessions.form,
        "simulated": sessions.simulated,
        "subjects": len(sessions.subjects),
        "rows": len(sessions.table),
        "environments": list(sessions.environments),
        "references": len(
            sessions.factor.environments if sessions.factor else sessions.environments
        ),
        "factor": sessions.factor.name if sessions.factor else None,
        "parameters": list(sessions.parameters),
        "quantities": {p: sessions.quantities[p].model_dump() for p in sessions.parameters},
        "words": plain(
            {
                "environment": study.scene.environment_noun,
                "subject": study.scene.study.subject,
                "user": study.scene.user_noun,
            }
        ),
        "counts": plain(sessions.counts),
        "notices": [_located(notice, "text") for notice in sessions.notices],
        "doubts": [_located(warning, "text") for warning in sessions.warnings],
        "exclusions": [_located(row, "who", "what", "why") for row in sessions.exclusions],
        "design": design_counts(sessions),
        "cells": plain(list(adjustments(sessions))),
    }


def _located(record: Any, *names: str) -> dict[str, Any]:
    where = {"file": PurePath(record.file).name if record.file else None, "row": record.row}
    return {name: plain(getattr(record, name)) for name in names} | where


def _close_views(study: Study, windows: Mapping[str, list[float]]) -> list[dict[str, Any]]:
    """Evaluate the boundaries that the page draws in each window."""
    asked = study.scene.inference.kinds
    kinds = ["user" if "user" in asked else asked[0]]
    return [
        plain(record)
        for name, (low, high) in windows.items()
        for record in study.boundaries_at(
            np.linspace(low, high, _CLOSE_POINTS), (name,), kinds=kinds, joints=EACH_BY_ITSELF
        )
    ]


def design_of(study: Study) -> dict[str, Any] | None:
    """Unpack the couplings that qualify, by method, for each environment and for all together."""
    designs = study.coupling_design
    if not designs:
        return None
    fields = ("intervals", "largest", "softest")
    maps = []
    for method, design in designs.items():
        regions = zip((*study.with_reference, None), (*design.each, design.common), strict=True)
        environments = [
            {"name": name} | {f: plain(getattr(r, f)) for f in fields} for name, r in regions
        ]
        damping = plain(design.common.damping)
        maps.append({"method": method, "damping": damping, "environments": environments})
    family = study.scene.inference.family
    return {"kind": "user", "family": family, "stable": _stable_edge(study), "maps": maps}


def _stable_edge(study: Study) -> dict[str, Any] | None:
    device, table = study.device, study.scene.device
    if table is None or not isinstance(device, Device) or device.modes:
        return None
    edge = stable_region(float(device.damping), table.period, hold=table.hold, points=_EDGE_POINTS)
    return {"stiffness": plain(edge[0]), "damping": plain(edge[1])}


def _checks(study: Study) -> dict[str, Any] | None:
    """Collect the model checks that the scene asks for."""
    if study.scene.checks is None:
        return None
    normality = plain(normality_tests(study.sessions, study.parameters))
    if study.checks is None:
        return {"normality": normality} if normality else None
    checks: dict[str, Any] = {"normality": normality, **plain(study.checks)}
    # A row per subject, environment and parameter would be most of the document.
    checks["loo"]["cells"] = [row for row in checks["loo"]["cells"] if row["outlier"]]
    return checks
