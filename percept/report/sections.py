"""The sections of the page that give results; each takes the document and returns itself, or None."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from percept.boundary.band import size_name
from percept.report.basis import (
    checks,
    comparison,
    data,
    diagnostics,
    methods,
)
from percept.report.contrast import contrast
from percept.report.feelings import feelings
from percept.report.numbers import digits_of
from percept.report.overview import summary
from percept.report.select import (
    KINDS,
    METHODS,
    Record,
    Section,
    array,
    choice_said,
    chosen,
    distinct,
    each_by_itself,
    families_of,
    family_of,
    first,
    matching,
    ordered,
    pointed,
    quantities_of,
    words_of,
)
from percept.sessions.quantities import Quantity

__all__ = ["build_sections"]

_SHAPES = {
    "corner": (
        "both lower limits of k and b together, and both upper limits together, as in the paper"
        " (Eqs 16 and 17); the two curves can cross"
    ),
    "envelope": (
        "the exact smallest and largest |Z_h| that any k and b within their limits can give"
    ),
    "pointwise": "limits of |Z_h| by the law of k and b together; the level holds at each ω alone",
    "simultaneous": (
        "limits between which a whole curve stays at every ω drawn: pointwise limits at a higher"
        " level (Bayesian), or limits of Hotelling’s ellipse joined with the pointwise ones"
        " (classical)"
    ),
}
_BINDS = {"stability": "stability", "magnitude": "|Z_h|", "plane": "k and b"}
_LAWS = {
    "weber": "Weber, w·{0}",
    "offset": "Weber with offset, c + w·{0}",
    "power": "power law, w·{0}^p",
}


def build_sections(document: Record) -> list[Section]:
    """Return the sections a document needs, in reading order; what it has nothing for is absent."""
    sections = (
        summary(document),
        intervals(document),
        contrast(document),
        boundaries(document),
        feelings(document),
        _part(document, "passivity", "direct", "Passivity without a coupling"),
        coupling(document),
        design(document),
        _part(document, "sensitivity", "device", "Sensitivity to device mass and damping"),
        band(document),
        comparison(document),
        diagnostics(document),
        checks(document),
        data(document),
        methods(document),
        _part(document, "provenance", "provenance", "Provenance"),
        _part(document, "skipped", "skipped", "Not computed"),
    )
    return [section for section in sections if section is not None]


def _part(document: Record, part: str, name: str, title: str) -> Section | None:
    """Return a section that shows a part of the document as it stands."""
    if not document[part]:
        return None
    return Section(name, title, {part: document[part]})


def intervals(document: Record) -> Section | None:
    """Return a matrix per quantity in the study's family, and what each interval covers."""
    rows = pointed(document["intervals"], "/intervals")
    if not rows:
        return None
    marginal = matching(rows, joint="marginal")
    quantities = quantities_of(document)
    families = families_of(document)
    matrices = []
    for name in distinct(marginal, "parameter"):
        matrices.append(_matrix(matching(marginal, parameter=name), families, quantities[name]))
    values = {"matrices": matrices, "sentences": _sentences(rows)}
    return Section("intervals", "Intervals of the adjustments", values)


def _matrix(rows: Sequence[Record], families: Sequence[str], quantity: Quantity) -> Record:
    """Return a row per environment and a column per kind and method, in the first family each has."""
    columns, lines = _grid(rows, families)
    families_shown = set()
    shown = []
    for line in lines:
        filled = [cell for cell in line["cells"] if cell]
        families_shown |= set(distinct(filled, "family"))
        shown.append(
            {
                "environment": line["environment"],
                "reference": f"{filled[0]['pointer']}/reference",
                "cells": [cell and {**cell, "digits": _digits(cell)} for cell in line["cells"]],
            }
        )
    return {
        "title": quantity.head,
        "parameter": rows[0]["parameter"],
        "unit": rows[0]["unit"],
        "family": ", else ".join(family for family in families if family in families_shown),
        "columns": columns,
        "rows": shown,
    }


def _grid(rows: Sequence[Record], families: Sequence[str]) -> tuple[list[Record], list[Record]]:
    """Return a column per kind and method, and a row per environment with its records under them."""
    columns = []
    for alike in _by_kind_and_method(rows):
        columns.append({"kind": alike[0]["kind"], "method": alike[0]["method"]})
    lines = []
    for name in distinct(rows, "environment"):
        of_environment = matching(rows, environment=name)
        cells = [first(matching(of_environment, **column), family=families) for column in columns]
        lines.append({"environment": name, "cells": cells})
    return list(columns), list(lines)


def _digits(cell: Record) -> list[int]:
    return [digits_of(cell[end], cell["lower"], cell["upper"]) for end in ("lower", "upper")]


def _sentences(rows: Sequence[Record]) -> list[Record]:
    """Return what each kind and method covers, each sentence once, with what it holds for."""
    sentences = []
    for alike in _by_kind_and_method(rows):
        for covers in distinct(alike, "covers"):
            same = matching(alike, covers=covers)
            of_family = matching(alike, family=same[0]["family"])
            where: list[str] = []
            if len(distinct(of_family, "covers")) > 1:
                where = [f"{row['parameter']} of {row['environment']}" for row in same]
            families = sorted(distinct(same, "family"), reverse=True)
            sentences.append({**same[0], "families": families, "where": list(dict.fromkeys(where))})
    return list(sentences)


def boundaries(document: Record) -> Section | None:
    """Return figures and values of each environment's boundaries, and the curves for the page's script."""
    records = document["boundaries"]
    if not records:
        return None
    names = distinct(records, "environment")
    values = {
        "quantities": " and ".join(distinct(document["intervals"], "parameter")),
        "shapes": [
            {"name": name, "meaning": _SHAPES[name]} for name in ordered(_SHAPES, records, "shape")
        ],
        "curves": [
            curves for name in chosen(names) if (curves := _curves(document, name)) is not None
        ],
        "left_out": choice_said(names, words_of(document).environments),
    }
    return Section("boundaries", "Realistic performance boundaries", values)


def _curves(document: Record, name: str) -> Record | None:
    """Return the curves the script draws, to seven digits; a grid or curve that is shared stands once."""
    of_environment = matching(document["boundaries"], environment=name)
    records = [record for record in of_environment if each_by_itself(record)]
    if not records:
        return None
    grids = [list(grid) for grid in dict.fromkeys(tuple(record["omega"]) for record in records)]
    limits = []
    for record in records:
        curve = {field: record[field] for field in ("kind", "method", "family", "shape")}
        curve["grid"] = grids.index(record["omega"])
        curve["lower"] = _short(record["lower"])
        curve["upper"] = _short(record["upper"])
        limits.append(curve)
    coupled = records[0]["coupled"]
    return {
        "name": name,
        "zoom": document["zoom"].get(name),
        "grids": [_short(grid) for grid in grids],
        "reference": _short(records[0]["reference"]),
        "coupled": None if coupled is None else _short(coupled),
        "limits": limits,
    }


def _short(values: list[Any]) -> list[float | None]:
    """Round to seven digits; what is not finite is not drawn."""
    return [
        float(f"{value:.7g}") if math.isfinite(value) else None for value in array(values).tolist()
    ]


def coupling(document: Record) -> Section | None:
    """Return the coupling's stability, and memberships in boundaries by the paper's rule."""
    record = document["coupling"]
    if not record:
        return None
    memberships = pointed(record["memberships"], "/coupling/memberships")
    values = {
        "coupling": record,
        "memberships": _memberships(memberships, family_of(document)),
        "effective": list({row["environment"]: row for row in memberships}.values()),
    }
    return Section("coupling", "The virtual coupling", values)


def _memberships(records: Sequence[Record], family: str) -> Record | None:
    """Return a row per environment, a column per kind and method: exact envelope, the study's family."""
    envelopes = matching(records, shape="envelope", family=family)
    main = [row for row in envelopes if each_by_itself(row)]
    if not main:
        return None
    columns, rows = _grid(main, [family])
    return {"family": family, "columns": columns, "rows": rows}


def _by_method(records: Sequence[Record]) -> list[Record]:
    """Return a row per environment and kind, with the pointer of each method's record."""
    rows = []
    for environment in distinct(records, "environment"):
        for kind in KINDS:
            alike = matching(records, environment=environment, kind=kind)
            if alike:
                pointers = {record["method"]: record["pointer"] for record in alike}
                rows.append({"environment": environment, "kind": kind, "pointers": pointers})
    return list(rows)


def design(document: Record) -> Section | None:
    """Return the stiffest and the softest coupling for each environment, and for all together."""
    record = document["design"]
    if not record:
        return None
    couplings = {}
    for by_method in pointed(record["maps"], "/design/maps")[::-1]:  # the Bayesian first
        regions = pointed(by_method["environments"], f"{by_method['pointer']}/environments")
        for region in regions:
            binds = region["largest"]["binds"] if region["largest"] else ()
            region["binds"] = ", ".join(_BINDS[name] for name in binds)
        couplings[by_method["method"]] = regions
    values = {"family": record["family"], "couplings": couplings}
    return Section("design", "Admissible couplings by the paper’s rule", values)


def band(document: Record) -> Section | None:
    """Return how wide the bands are against the impedance, or against references, and the laws."""
    record: Mapping[str, Any] = document["band"] or {}
    if not record.get("rows"):
        return None
    names = dict.fromkeys(row.get("parameter") for row in record["rows"])
    parts = [_band_part(document, record, parameter) for parameter in names]
    values = {"parts": parts, "trend": pointed(record.get("kappa"), "/band/kappa")}
    return Section(
        "band", f"Band against {'impedance' if None in names else 'the reference'}", values
    )


def _band_part(document: Record, record: Record, parameter: str | None) -> Record:
    """Return the bands of the impedance, or of one parameter, with their laws and statements."""
    family = family_of(document)
    wanted = {"family": family, "parameter": parameter}
    rows = matching(pointed(record["rows"], "/band/rows"), **wanted)
    laws = matching(pointed(record["laws"], "/band/laws"), **wanted)
    statements = matching(pointed(record["statements"], "/band/statements"), **wanted)
    if parameter is None:
        named = {"name": "band", "words": None, "symbol": "|Z|", "unit": "N·s/m"}
    else:
        quantity = quantities_of(document)[parameter]
        named = {"name": f"band_{parameter}", "words": quantity.words, "unit": quantity.unit}
        named["symbol"] = "reference"
    law_rows = []
    for alike in _by_kind_and_method(laws):
        cells = {law["model"]: law for law in alike}
        law_rows.append({"kind": alike[0]["kind"], "method": alike[0]["method"], "cells": cells})
    stated = []
    for name in distinct(statements, "statement"):
        pointers = [row["pointer"] for row in matching(statements, statement=name)]
        stated.append({"statement": name, "pointers": pointers})
    columns = matching(statements, statement=stated[0]["statement"]) if stated else []
    return {
        **named,
        "size": size_name(parameter),
        "rows": _by_method(rows),
        "laws": {name: _LAWS[name].format(named["symbol"]) for name in distinct(laws, "model")},
        "law_rows": law_rows,
        "family": family,
        "statements": stated,
        "stated": [{"kind": row["kind"], "method": row["method"]} for row in columns],
        "methods": ordered(METHODS, rows, "method"),
    }


def _by_kind_and_method(records: Sequence[Record]) -> list[list[Record]]:
    """Group records by kind and method, in the order of the page."""
    groups = []
    for kind in KINDS:
        for method in METHODS:
            alike = matching(records, kind=kind, method=method)
            if alike:
                groups.append(alike)
    return groups
