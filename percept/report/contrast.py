"""Conditions within subjects: what the first screen and the section of the factor say of their contrasts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from percept.errors import counted
from percept.inference.record import percent
from percept.report.numbers import bare, digits_of, rounded
from percept.report.select import (
    METHODS,
    Record,
    Section,
    distinct,
    listed,
    matching,
    ordered,
    pointed,
    quantities_of,
    words_of,
)

__all__ = ["contrast", "contrast_sentences"]

_SAID = 3  # more contrasts than this are counted on the first screen, not said


def contrast(document: Record) -> Section | None:
    """Return the contrasts of conditions within subjects, pair by pair of levels."""
    rows = pointed(document.get("contrast"), "/contrast")
    if not rows:
        return None
    quantities = quantities_of(document)
    pairs = list(dict.fromkeys((row["first"], row["second"]) for row in rows))
    tables = []
    for first, second in pairs:
        for parameter in distinct(rows, "parameter"):
            for of in ("bias", "spread"):
                alike = matching(rows, first=first, second=second, parameter=parameter, of=of)
                if alike:
                    tables.append(
                        {
                            "first": first,
                            "second": second,
                            "quantity": quantities[parameter],
                            "of": of,
                            "unit": alike[0]["unit"],
                            "errors": any(row["error"] is not None for row in alike),
                            "rows": alike,
                        }
                    )
    overall = [
        {
            **row,
            "label": quantities[row["parameter"]].label,
            "rests_on": listed(row["references"]),
        }
        for row in _overall(rows)
    ]
    values: dict[str, Any] = {
        "tables": tables,
        "overall": overall,
        "ratio": rows[0]["family"] == "lognormal",
        "bayesian": "bayesian" in distinct(rows, "method"),
        "factor": rows[0]["factor"],
        "cell": document["data"]["environments"][0],
    }
    versus = f"{pairs[0][1]} against {pairs[0][0]}" if len(pairs) == 1 else "levels two by two"
    return Section("contrast", f"{rows[0]['factor']}: {versus}", values)


def _overall(rows: Sequence[Record]) -> list[Record]:
    """Return the average user's contrast over all references, of each quantity's best method.

    Without any such contrast it is those of single references.
    """
    means = matching(rows, of="bias", kind="mean")
    overall = matching(means, environment=None) or means
    best = []
    for parameter in distinct(overall, "parameter"):
        alike = matching(overall, parameter=parameter)
        (method, *_) = ordered(METHODS[::-1], alike, "method")
        best += matching(alike, method=method)
    return best


def contrast_sentences(document: Record) -> list[str]:
    """Say how the levels of the factor differ, what that rests on, and how many contrasts more there are."""
    quantities = quantities_of(document)
    words = words_of(document)
    user, users = words.user, words.users
    rows = _overall(document.get("contrast") or ())
    said = []
    for row in rows[:_SAID]:
        of = f" in {row['environment']}" if row["environment"] is not None else ""
        label = f"{quantities[row['parameter']].label}{of}"
        estimate = float(row["estimate"])
        lower = float(row["lower"])
        upper = float(row["upper"])
        digits = digits_of(estimate, lower, upper)
        size = bare(rounded(estimate if row["family"] == "lognormal" else abs(estimate), digits))
        ends = " to ".join(bare(rounded(end, digits)) for end in (lower, upper))
        if row["family"] == "lognormal":
            how = f"{size} times as high with {row['second']} as"
        else:
            side = "lower" if estimate < 0 else "higher"
            how = f"{size} {row['unit']} {side} with {row['second']} than"
            ends = f"{ends} {row['unit']}"
        sure = "confidence" if row["method"] == "classical" else "probability"
        who = f"{row['n']} of {counted(row['of_subjects'], user, users)}"
        where = ""
        if row["environment"] is None:
            where = f" and {len(row['references'])} of {row['of_references']} references"
            if len(row["references"]) < row["of_references"]:
                where += f", {listed(row['references'])}"
        said.append(
            f"{users[:1].upper()}{users[1:]} set {label} {how} with {row['first']}: {ends} with"
            f" {percent(row['level'])} {sure}, from {who}{where}."
        )
    if len(rows) > _SAID:
        more = counted(len(rows) - _SAID, "contrast")
        said.append(f"The section on {rows[0]['factor']} has {more} more.")
    return said
