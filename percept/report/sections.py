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
)
from percept.sessions.quantities import Quantity

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
    passivity, sensitivity = (
        "Passivity without a coupling",
        "Sensitivity to device mass and damping",
    )
    sections = (
        summary(document), intervals(document), contrast(document), boundaries(document),
        _part(document, "passivity", "direct", passivity), coupling(document), design(document),
        _part(document, "sensitivity", "device", sensitivity), band(document), comparison(document),
        diagnostics(document), checks(document), data(document), methods(document),
        _part(document, "provenance", "provenance", "Provenance"),
        _part(document, "skipped", "skipped", "Not computed"),
    )  # fmt: skip
    return [section for section in sections if section is not None]


def _part(document: Record, part: str, name: str, title: str) -> Section | None:
    """Return a section that shows a part of the document as it stands."""
    return Section(name, title, {part: document[part]}) if document[part] else None


def intervals(document: Record) -> Section | None:
    """Return a matrix per quantity in the study's family, and what each interval covers."""
    rows = pointed(document["intervals"], "/intervals")
    if not rows:
        return None
    marginal, quantities = matching(rows, joint="marginal"), quantities_of(document)
    names = distinct(marginal, "parameter")
    matrices = [
        _matrix(matching(marginal, parameter=name), families_of(document), quantities[name])
        for name in names
    ]
    values = {"matrices": matrices, "sentences": _sentences(rows)}
    return Section("intervals", "Intervals of the adjustments", values)


def _matrix(rows: list[Record], families: Sequence[str], quantity: Quantity) -> dict[str, Any]:
    """Return a row per environment and a column per kind and method, in the first family each has."""
    columns, lines = _grid(rows, families)
    used = {cell["family"] for line in lines for cell in line["cells"] if cell}
    return {
        "title": quantity.head,
        "parameter": rows[0]["parameter"],
        "unit": rows[0]["unit"],
        "family": ", else ".join(family for family in families if family in used),
        "columns": columns,
        "rows": [
            {
                "environment": line["environment"],
                "reference": next(f"{cell['pointer']}/reference" for cell in line["cells"] if cell),
                "cells": [cell and {**cell, "digits": _digits(cell)} for cell in line["cells"]],
            }
            for line in lines
        ],
    }


def _grid(
    rows: list[Record], families: Sequence[str]
) -> tuple[list[dict[str, str]], list[dict[str, Any]]]:
    """Return a column per kind and method, and a row per environment with its records under them."""
    columns = [
        {"kind": alike[0]["kind"], "method": alike[0]["method"]}
        for alike in _by_kind_and_method(rows)
    ]
    lines = []
    for name in distinct(rows, "environment"):
        own = matching(rows, environment=name)
        cells = [first(matching(own, **column), family=families) for column in columns]
        lines.append({"environment": name, "cells": cells})
    return columns, lines


def _digits(cell: Record) -> list[int]:
    return [digits_of(cell[end], cell["lower"], cell["upper"]) for end in ("lower", "upper")]


def _sentences(rows: Sequence[Record]) -> list[dict[str, Any]]:
    """Return what each kind and method covers, each sentence once, with what it holds for."""
    found = []
    for same in _by_kind_and_method(rows):
        for covers in distinct(same, "covers"):
            carried = matching(same, covers=covers)
            alone = len(distinct(matching(same, family=carried[0]["family"]), "covers")) == 1
            where = dict.fromkeys(f"{row['parameter']} of {row['environment']}" for row in carried)
            families = sorted(distinct(carried, "family"), reverse=True)
            found.append(
                {**carried[0], "families": families, "where": [] if alone else list(where)}
            )
    return found


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
        "left_out": choice_said(names),
    }
    return Section("boundaries", "Realistic performance boundaries", values)


def _curves(document: Record, name: str) -> dict[str, Any] | None:
    """Return the curves the script draws, to seven digits; a grid or curve that is shared stands once."""
    records = [r for r in matching(document["boundaries"], environment=name) if each_by_itself(r)]
    if not records:
        return None
    grids = [list(grid) for grid in dict.fromkeys(tuple(record["omega"]) for record in records)]
    coupled = records[0].get("coupled")
    return {
        "name": name,
        "zoom": document["zoom"].get(name),
        "grids": [_short(grid) for grid in grids],
        "reference": _short(records[0]["reference"]),
        "coupled": None if coupled is None else _short(coupled),
        "limits": [
            {field: record[field] for field in ("kind", "method", "family", "shape")}
            | {"grid": grids.index(record["omega"])}
            | {side: _short(record[side]) for side in ("lower", "upper")}
            for record in records
        ],
    }


def _short(values: list[Any]) -> list[float | None]:
    """Round to seven digits; what is not finite is not drawn."""
    return [
        float(f"{value:.7g}") if math.isfinite(value) else None for value in array(values).tolist()
    ]


def coupling(document: Record) -> Section | None:
    """Return the coupling's stability, and whether it feels real."""
    record = document["coupling"]
    if not record:
        return None
    realism = pointed(record.get("realism"), "/coupling/realism")
    probability = pointed(record.get("probability"), "/coupling/probability")
    admissible = {
        row["environment"]: {**row, "broken": ", ".join(_BINDS[name] for name in row["breaks"])}
        for row in pointed(document["summary"]["overview"]["realism"], "/summary/overview/realism")
    }
    pointers: dict[str, dict[str, str]] = {}
    for row in probability:
        side = "coupled" if row["coupled"] else "directly"
        pointers.setdefault(row["environment"], {})[side] = row["pointer"]
    values = {
        "coupling": record,
        "realism": _realism(realism, family_of(document)),
        "judged": [
            {
                "environment": name,
                "admissible": admissible.get(name),
                "pointers": pointers.get(name, {}),
            }
            for name in {**admissible, **pointers}
        ],
        "rendered": list(next(iter(pointers.values()), {})),
        "effective": list({row["environment"]: row for row in realism}.values()),
        "summary": document["data"]["form"] == "summary",
    }
    return Section("coupling", "The virtual coupling", values)


def _realism(records: Sequence[Record], family: str) -> dict[str, Any] | None:
    """Return a row per environment, a column per kind and method: exact envelope, the study's family."""
    kept = [
        row for row in matching(records, shape="envelope", family=family) if each_by_itself(row)
    ]
    if not kept:
        return None
    columns, rows = _grid(kept, [family])
    return {"family": family, "columns": columns, "rows": rows}


def _by_method(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Return a row per environment and kind, with the pointer of each method's record."""
    return [
        {
            "environment": environment,
            "kind": kind,
            "pointers": {r["method"]: r["pointer"] for r in cell},
        }
        for environment in distinct(records, "environment")
        for kind in KINDS
        if (cell := matching(records, environment=environment, kind=kind))
    ]


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
    return Section(
        "design", "Admissible couplings", {"family": record["family"], "couplings": couplings}
    )


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


def _band_part(document: Record, record: Record, parameter: str | None) -> dict[str, Any]:
    """Return the bands of the impedance, or of one parameter, with their laws and statements."""
    family = family_of(document)
    rows, laws, statements = (
        matching(pointed(record.get(name), f"/band/{name}"), family=family, parameter=parameter)
        for name in ("rows", "laws", "statements")
    )
    quantity = None if parameter is None else quantities_of(document)[parameter]
    symbol = "|Z|" if quantity is None else "reference"
    return {
        "size": size_name(parameter),
        "symbol": symbol,
        "words": None if quantity is None else quantity.words,
        "name": "band" if parameter is None else f"band_{parameter}",
        "unit": "N·s/m" if quantity is None else quantity.unit,
        "rows": _by_method(rows),
        "laws": {name: _LAWS[name].format(symbol) for name in distinct(laws, "model")},
        "law_rows": [
            {"kind": alike[0]["kind"], "method": alike[0]["method"]}
            | {"cells": {law["model"]: law for law in alike}}
            for alike in _by_kind_and_method(laws)
        ],
        "family": family,
        "statements": [
            {
                "statement": name,
                "pointers": [row["pointer"] for row in matching(statements, statement=name)],
            }
            for name in distinct(statements, "statement")
        ],
        "stated": [
            {"kind": row["kind"], "method": row["method"]}
            for row in matching(
                statements, statement=statements[0]["statement"] if statements else None
            )
        ],
        "methods": ordered(METHODS, rows, "method"),
    }


def _by_kind_and_method(records: Sequence[Record]) -> list[list[Record]]:
    """Group records by kind and method, in the order of the page."""
    groups = (matching(records, kind=kind, method=method) for kind in KINDS for method in METHODS)
    return [group for group in groups if group]
