"""What the summary says, worked out from the rest of the document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from percept.errors import counted
from percept.report.overview import overview
from percept.report.select import METHODS, Record, distinct, matching

#: Fewer subjects than this are called few.
_FEW = 5
#: Of the reader's warnings the summary repeats the first.
_WARNINGS = 4


def findings(document: Mapping[str, Any]) -> dict[str, Any]:
    """Count what a reader asks first."""
    intervals = document["intervals"]
    return {
        "overview": overview(document),
        "references": list(_references(intervals)),
        "widths": _widths(intervals),
        "cautions": [
            *_levels(document.get("contrast")),
            *_left_out(document.get("skipped") or ()),
            *_inaccurate(document.get("diagnostics")),
            *_few(intervals),
            *_below_zero(intervals, document["data"]["quantities"]),
            *_active(document["passivity"]),
            *_misfits(document.get("checks")),
            *_warnings(document["data"]["doubts"]),
        ],
    }


def _levels(contrast: list[Record] | None) -> Iterator[str]:
    """Say what the levels of a factor are to everything but the contrasts."""
    if contrast:
        yield (
            f"Each level of {contrast[0]['factor']} stands as a condition of its own. Only the section on "
            f"{contrast[0]['factor']} compares levels within subjects."
        )


def _left_out(skipped: Sequence[Record]) -> Iterator[str]:
    """Say what the hierarchical model is missing, or that there is none."""
    for row in skipped:
        if row["what"].endswith(", in the hierarchical model"):
            yield f"The hierarchical model leaves out {row['what'].partition(',')[0]}: {row['why']}."
        elif row["what"] == "Bayesian intervals":
            yield f"There are no Bayesian intervals: {row['why']}"


def _inaccurate(diagnostics: Record | None) -> Iterator[str]:
    gate = diagnostics["gate"] if diagnostics else None
    if gate and gate["passed"] and not gate["tolerance_met"]:
        yield gate["error_reached"]


def _few(intervals: list[Record]) -> Iterator[str]:
    subjects = max((row["n"] for row in intervals), default=_FEW)
    if subjects < _FEW:
        rest = {
            "classical": f"classical limits rest on {counted(subjects - 1, 'degree')} of freedom",
            "bayesian": "Bayesian limits rest largely on the priors",
        }
        methods = [rest[method] for method in METHODS if matching(intervals, method=method)]
        yield f"{subjects} subjects are few: {', '.join(methods)}."


def _below_zero(intervals: list[Record], quantities: Mapping[str, Record]) -> Iterator[str]:
    cells: dict[str, dict[str, None]] = {}
    for row in matching(intervals, family="normal", joint="marginal"):
        if row["lower"] is not None and float(row["lower"]) < 0 <= (row["reference"] or 0.0):
            cells.setdefault(row["kind"], {})[f"{row['parameter']} of {row['environment']}"] = None
    if cells:
        labels = " or ".join(record["label"] for record in quantities.values())
        where = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in cells.items())
        yield (
            f"Some limits of the normal family are below zero, where no environment's {labels} is "
            f"({where}). Those of the lognormal family never are."
        )


def _active(passivity: list[Record] | None) -> Iterator[str]:
    names = [row["environment"] for row in passivity or () if not row["passive"]]
    if names:
        yield (
            f"Without a coupling this device has too little damping to render {', '.join(names)} passively "
            "(Colgate and Schenkel): such references may chatter, and adjustments to them may be biased."
        )


def _misfits(checks: Record | None) -> Iterator[str]:
    """Say what the checks of the model found."""
    if not checks:
        return
    for family in distinct(checks["normality"], "family"):
        rows = matching(checks["normality"], family=family)
        # Bonferroni over the cells tested: a study of many cells is not alarmed by chance.
        cells = [
            f"{row['parameter']} of {row['environment']}" for row in rows if row["p_value"] * len(rows) < 0.05
        ]
        if cells:
            yield (
                f"Shapiro–Wilk tests reject the {family} family, which its classical intervals assume, for "
                f"{', '.join(cells)}."
            )
    if checks.get("loo"):
        yield from checks["loo"]["messages"]
        unusual = [
            f"{row['statistic']} of {row['parameter']} in {row['environment']}"
            for row in checks["statistics"]
            if row["unusual"]
        ]
        if unusual:
            yield f"The hierarchical model does not reproduce the {'; '.join(unusual)}."


def _warnings(warnings: list[Record]) -> Iterator[str]:
    for warning in warnings[:_WARNINGS]:
        where = f"{warning['file']}:{warning['row']}: " if warning["file"] else ""
        yield f"{where}{warning['text']}{'' if warning['text'].endswith(('?', '.')) else '.'}"
    if len(warnings) > _WARNINGS:
        yield f"Data lists {len(warnings) - _WARNINGS} more to look at."


def _known(rows: list[Record]) -> list[Record]:
    """Return the intervals that have a reference and both limits."""
    return [row for row in rows if None not in (row["reference"], row["lower"], row["upper"])]


def _references(intervals: list[Record]) -> Iterator[dict[str, Any]]:
    """Count, by method and family, the references inside the interval of the average user."""
    for method in METHODS:
        rows = _known(matching(intervals, method=method, kind="mean", joint="marginal"))
        for family in distinct(rows, "family"):
            cells = matching(rows, family=family)
            outside = [
                {name: row[name] for name in ("environment", "parameter")}
                for row in cells
                if not float(row["lower"]) <= row["reference"] <= float(row["upper"])
            ]
            yield {
                "method": method,
                "family": family,
                "level": cells[0]["level"],
                "inside": len(cells) - len(outside),
                "of": len(cells),
                "outside": outside,
            }


def _widths(intervals: list[Record]) -> list[dict[str, Any]]:
    """Return the narrowest and the widest interval over its reference, by what else tells intervals apart."""
    labels = ("method", "family", "parameter", "kind")
    groups: dict[tuple[str, ...], list[tuple[float, str]]] = {}
    for row in _known(matching(intervals, joint="marginal")):
        if row["reference"]:
            width = (float(row["upper"]) - float(row["lower"])) / row["reference"]
            groups.setdefault(tuple(row[name] for name in labels), []).append((width, row["environment"]))
    return [
        dict(zip(labels, group, strict=True))
        | {
            name: {"environment": environment, "width": width}
            for name, (width, environment) in (("narrowest", min(widths)), ("widest", max(widths)))
        }
        for group, widths in groups.items()
    ]
