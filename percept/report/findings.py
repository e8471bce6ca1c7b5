"""What the summary says, worked out from the rest of the document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from percept.errors import counted
from percept.report.select import METHODS, distinct, matching

#: Fewer subjects than this are called few.
_FEW = 5
_SHOWN = 4


def findings(document: Mapping[str, Any]) -> dict[str, Any]:
    """Count what a reader asks first."""
    intervals = document["intervals"]
    return {
        "references": _references(intervals),
        "widths": _widths(intervals),
        "cautions": [
            *_inaccurate(document.get("diagnostics")),
            *_few(intervals),
            *_below_zero(intervals),
            *_active(document["passivity"]),
            *_doubtful(document["data"]["doubts"]),
        ],
    }


def _inaccurate(diagnostics: Mapping[str, Any] | None) -> Iterator[str]:
    gate = diagnostics["gate"] if diagnostics else None
    if gate and gate["passed"] and not gate["tolerance_met"]:
        yield gate["error_reached"]


def _few(intervals: list[dict[str, Any]]) -> Iterator[str]:
    subjects = max((row["n"] for row in intervals), default=_FEW)
    if subjects < _FEW:
        rest = {
            "classical": f"classical limits rest on {counted(subjects - 1, 'degree')} of freedom",
            "bayesian": "Bayesian limits rest largely on the priors",
        }
        methods = [rest[method] for method in METHODS if matching(intervals, method=method)]
        yield f"{subjects} subjects are few: {', '.join(methods)}."


def _below_zero(intervals: list[dict[str, Any]]) -> Iterator[str]:
    cells: dict[str, list[str]] = {}
    for row in matching(intervals, family="normal", joint="marginal"):
        if row["lower"] is not None and float(row["lower"]) < 0 <= (row["reference"] or 0.0):
            cells.setdefault(row["kind"], []).append(f"{row['parameter']} of {row['environment']}")
    if cells:
        where = "; ".join(f"{kind}: {', '.join(dict.fromkeys(names))}" for kind, names in cells.items())
        yield (
            "Some limits of the normal family are below zero, where no environment's stiffness or damping is "
            f"({where}). Those of the lognormal family never are."
        )


def _active(passivity: list[dict[str, Any]] | None) -> Iterator[str]:
    names = [row["environment"] for row in passivity or () if not row["passive"]]
    if names:
        yield (
            f"Without a coupling this device has too little damping to render {', '.join(names)} passively "
            "(Colgate and Schenkel): such references may chatter, and adjustments to them may be biased."
        )


def _doubtful(doubts: list[dict[str, Any]]) -> Iterator[str]:
    for doubt in doubts[:_SHOWN]:
        place = f"{doubt['file']}:{doubt['row']}: " if doubt["file"] else ""
        yield f"{place}{doubt['text']}{'' if doubt['text'].endswith('?') else '.'}"
    if len(doubts) > _SHOWN:
        yield f"Data lists {len(doubts) - _SHOWN} more to look at."


def _references(intervals: list[dict[str, Any]]) -> list[dict[str, Any]]:
    found = []
    for method in METHODS:
        rows = matching(intervals, method=method, kind="mean", joint="marginal")
        for family in distinct(rows, "family"):
            known = [
                row
                for row in matching(rows, family=family)
                if row["reference"] is not None and row["lower"] is not None and row["upper"] is not None
            ]
            outside = [
                {name: row[name] for name in ("environment", "parameter")}
                for row in known
                if not float(row["lower"]) <= row["reference"] <= float(row["upper"])
            ]
            if known:
                found.append(
                    {
                        "method": method,
                        "family": family,
                        "level": known[0]["level"],
                        "inside": len(known) - len(outside),
                        "of": len(known),
                        "outside": outside,
                    }
                )
    return found


def _widths(intervals: list[dict[str, Any]]) -> list[dict[str, Any]]:
    groups: dict[tuple[str, str, str, str], list[tuple[float, str]]] = {}
    for row in matching(intervals, joint="marginal"):
        if not row["reference"] or row["lower"] is None or row["upper"] is None:
            continue
        key = (row["method"], row["family"], row["parameter"], row["kind"])
        width = (float(row["upper"]) - float(row["lower"])) / row["reference"]
        groups.setdefault(key, []).append((width, row["environment"]))
    found = []
    for (method, family, parameter, kind), widths in groups.items():
        (least, narrowest), (most, widest) = min(widths), max(widths)
        found.append(
            {
                "method": method,
                "family": family,
                "parameter": parameter,
                "kind": kind,
                "narrowest": {"environment": narrowest, "width": least},
                "widest": {"environment": widest, "width": most},
            }
        )
    return found
