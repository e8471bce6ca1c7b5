"""What to know before relying on the numbers: cautions of the first screen, from the document."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from percept.errors import counted
from percept.report.select import (
    METHODS,
    STATISTICS,
    Record,
    Words,
    distinct,
    listed,
    matching,
    words_of,
)

__all__ = ["cautions", "misfits"]

_FEW = 5  # fewer subjects than this are called few
_WARNINGS = 4  # the summary repeats the reader's first warnings


def cautions(document: Record) -> list[str]:
    """Return the cautions of a document, those that change its meaning first."""
    gate = (document.get("diagnostics") or {}).get("gate")
    words = words_of(document)
    found = [*_levels(document.get("contrast"), words), *_left_out(document.get("skipped") or ())]
    if gate and gate["passed"] and not gate["tolerance_met"]:
        found.append(gate["error_reached"])
    found += _few(document["intervals"], words)
    found += _below_zero(document["intervals"], document["data"])
    found += _active(document["passivity"], words)
    found += (document.get("diagnostics") or {}).get("pull") or ()
    found += misfits(document.get("checks"), words)
    found += _warnings(document["data"]["doubts"])
    return found


def _levels(contrast: list[Record] | None, words: Words) -> Iterator[str]:
    """Say what the levels of a factor are to everything but the contrasts."""
    if contrast:
        yield (
            f"Outside the section on {contrast[0]['factor']} each of its levels stands by itself. "
            f"Only that section compares levels within {words.subjects}."
        )


def _left_out(skipped: Sequence[Record]) -> Iterator[str]:
    """Say what the hierarchical model is missing, or that there is none."""
    for row in skipped:
        if row["what"].endswith(", in the hierarchical model"):
            yield (
                f"The hierarchical model leaves out {row['what'].partition(',')[0]}: {row['why']}."
            )
        elif row["what"] == "Bayesian intervals":
            yield f"There are no Bayesian intervals: {row['why']}"


def _few(intervals: list[Record], words: Words) -> Iterator[str]:
    subjects = max((row["n"] for row in intervals), default=_FEW)
    if subjects < _FEW:
        rest = {
            "classical": f"classical limits rest on {counted(subjects - 1, 'degree')} of freedom",
            "bayesian": "Bayesian limits rest largely on the priors",
        }
        methods = [rest[method] for method in METHODS if matching(intervals, method=method)]
        yield f"{subjects} {words.subjects} are few: {', '.join(methods)}."


def _below_zero(intervals: list[Record], data: Record) -> Iterator[str]:
    cells: dict[str, dict[str, None]] = {}
    # What people set below zero is a quantity that may lie there.
    signed = {cell["parameter"] for cell in data["cells"] if min(cell["values"], default=0.0) < 0}
    for row in matching(intervals, family="normal", joint="marginal"):
        if row["lower"] is None or row["parameter"] in signed:
            continue
        if float(row["lower"]) < 0 <= (row["reference"] or 0.0):
            cells.setdefault(row["kind"], {})[f"{row['parameter']} of {row['environment']}"] = None
    if cells:
        labels = " or ".join(
            data["quantities"][p]["label"] for p in data["quantities"] if p not in signed
        )
        where = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in cells.items())
        yield (
            f"Some limits of the normal family are below zero, where no {labels} can be ({where})."
            " Limits of the lognormal family never are."
        )


def _active(passivity: list[Record] | None, words: Words) -> Iterator[str]:
    names = [row["environment"] for row in passivity or () if not row["passive"]]
    if names:
        yield (
            f"Without a coupling this device has too little damping to render {listed(names)}"
            f" passively (Colgate and Schenkel). They may chatter, and {words.users} may then set them"
            " wrongly."
        )


def misfits(checks: Record | None, words: Words) -> Iterator[str]:
    """Say what the checks of the model found."""
    if not checks:
        return
    for family in distinct(checks["normality"], "family"):
        rows = matching(checks["normality"], family=family)
        # Bonferroni over the cells tested: a study of many cells is not alarmed by chance.
        cells = [
            f"{row['parameter']} of {row['environment']}"
            for row in rows
            if row["p_value"] * len(rows) < 0.05
        ]
        if cells:
            yield (
                f"Shapiro–Wilk tests reject the {family} family, which its classical intervals"
                f" assume, for {', '.join(cells)}."
            )
    if checks.get("loo"):
        yield from checks["loo"]["messages"]
        unusual = []
        for row in checks["statistics"]:
            if row["unusual"]:
                statistic = STATISTICS[row["statistic"]].format(subject=words.subject)
                unusual.append(f"{statistic} of {row['parameter']} in {row['environment']}")
        if unusual:
            yield f"The hierarchical model does not reproduce the {'; '.join(unusual)}."
        yield from checks["pull"]


def _warnings(warnings: list[Record]) -> Iterator[str]:
    for warning in warnings[:_WARNINGS]:
        where = f"{warning['file']}:{warning['row']}: " if warning["file"] else ""
        yield f"{where}{warning['text']}{'' if warning['text'].endswith(('?', '.')) else '.'}"
    if len(warnings) > _WARNINGS:
        yield f"Data lists {len(warnings) - _WARNINGS} more to look at."
