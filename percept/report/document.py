"""The document of a report: everything a study found, as report.json holds it."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from percept.report.checks import checks_of
from percept.report.curves import close_views, readings, zoom_windows
from percept.report.design import design_of
from percept.report.findings import findings
from percept.report.plain import plain
from percept.report.select import distinct
from percept.study.adjustments import adjustments, design_counts

if TYPE_CHECKING:
    from percept.study import Study

SCHEMA = "percept-report/1"

_PACKAGES = ("numpy", "scipy", "pandas", "emcee", "arviz-base", "arviz-stats")
# In the order they are written.
_PARTS = (
    "schema", "provenance", "data", "intervals", "boundaries", "zoom", "close", "readings", "passivity",
    "coupling", "band", "design", "sensitivity", "comparison", "curve_comparison", "diagnostics", "checks",
    "skipped", "summary",
)  # fmt: skip


def build_document(
    study: Study,
    *,
    curves: bool = True,
) -> dict[str, Any]:
    """Build the document that the page, the tables and the figures are made from.

    Parameters
    ----------
    study : Study
        What it has not computed yet is computed now.
    curves : bool
        Whether boundaries, the coupling judged by them and the band law are wanted; else they are absent.

    Returns
    -------
    dict
        ``schema``, ``provenance``, ``data``, ``intervals``, ``boundaries`` with their ``zoom`` windows,
        ``close`` views and ``readings`` at one frequency, ``coupling``, ``band``, ``design``,
        ``sensitivity``, ``comparison``, ``curve_comparison``, ``diagnostics``, ``checks``, ``skipped``, and
        what is worked out from them: ``summary``. JSON values only (see `percept.report.plain`), in the units
        of the tables: N/m, N·s/m, rad/s, kg, s. No durations, no folders.
    """
    document: dict[str, Any] = dict.fromkeys(_PARTS)
    document |= {
        "schema": SCHEMA,
        "provenance": provenance(study),
        "data": _data(study),
        "intervals": plain(study.intervals),
        "boundaries": [],
        "zoom": {},
        "close": [],
        "readings": [],
    }
    document["boundaries"] = plain(study.boundaries) if curves else []
    if document["boundaries"]:
        document["zoom"] = zoom_windows(study.scene, distinct(document["boundaries"], "environment"))
        document["close"] = close_views(study, document["zoom"])
        document["readings"] = readings(study)
    document |= {
        "coupling": plain(study.coupling) if curves else None,
        "passivity": plain(study.passivity) if curves else None,
        "band": plain(study.band) if curves else None,
        "design": design_of(study) if document["boundaries"] and study.scene.coupling else None,
    }
    document |= {
        "sensitivity": plain(study.sensitivity) if curves else None,
        "comparison": plain(study.comparison),
        "curve_comparison": plain(study.curve_comparison) if curves else [],
        "diagnostics": plain(study.diagnostics),
        "checks": checks_of(study),
        "skipped": _skipped(study, curves=curves),
    }
    document["summary"] = findings(document)
    return document


def provenance(study: Study) -> dict[str, Any]:
    """Say what a result was made from: versions, seed, files and scene."""
    import percept

    scene = plain(study.scene.to_dict())
    return {
        "versions": {"percept": percept.__version__, "python": platform.python_version(), **_versions()},
        "seed": study.scene.inference.seed,
        "files": [
            {"name": PurePath(source.name).name, "sha256": source.sha256, "rows": source.rows}
            for source in study.sessions.sources
        ],
        "scene": scene,
    }


def _versions() -> dict[str, str]:
    found = {}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def _data(study: Study) -> dict[str, Any]:
    sessions = study.sessions
    table = sessions.table
    return {
        "form": sessions.form,
        "simulated": sessions.simulated,
        "subjects": len(sessions.subjects),
        "rows": len(table),
        "environments": list(sessions.environments),
        "parameters": list(sessions.parameters),
        "counts": plain(sessions.counts),
        "notices": [_located(notice, "text") for notice in sessions.notices],
        "doubts": [_located(warning, "text") for warning in sessions.warnings],
        "exclusions": [_located(row, "who", "what", "why") for row in sessions.exclusions],
        "design": design_counts(sessions),
        "cells": plain(list(adjustments(sessions))),
    }


def _skipped(study: Study, *, curves: bool) -> list[dict[str, str]]:
    """Say what is left out, and without curves also what the report alone has."""
    found = [{"what": what, "why": why} for what, why in study.skipped]
    if curves or not len(study.intervals):
        return found
    coupled = study.apparatus is not None and study.scene.coupling is not None
    left = {
        "boundaries of Z_h": study.apparatus is not None,
        "coupling: Z_h_vc and stability": coupled,
        "couplings that would do": coupled,
        "sensitivity to the device's mass and damping": study.apparatus is not None,
        "band law": len(study.parameters) == 2 and len(study.environments) > 1,
    }
    known = {row["what"] for row in found}
    only = [name for name, there in left.items() if there and name not in known]
    return [*({"what": name, "why": "only percept report has this"} for name in only), *found]


def _located(record: Any, *names: str) -> dict[str, Any]:
    place = {"file": PurePath(record.file).name if record.file else None, "row": record.row}
    return {name: plain(getattr(record, name)) for name in names} | place
