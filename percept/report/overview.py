"""The answer first: the findings in a few sentences, a row per quantity and environment, and cautions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from percept.inference.record import percent
from percept.report.cautions import cautions
from percept.report.contrast import contrast_sentences
from percept.report.feelings import RENDERED, feeling_sentences
from percept.report.numbers import bare, digits_of, rounded
from percept.report.select import (
    METHOD_NAMES,
    METHODS,
    Record,
    Section,
    Words,
    compared_by_difference,
    distinct,
    families_of,
    first,
    listed,
    makes_impedance,
    matching,
    pointed,
    quantities_of,
    words_of,
)
from percept.sessions.quantities import Quantity

_NAMED = 5  # more names than this are counted, not listed
_KIND = "user"  # whose range stands beside the average's interval


#: A bias of so many references and more is written as a multiple.
_MULTIPLE = 9.0
#: Per cent from which on two digits would round whole per cents away.
_LEAST_WHOLE = 99.5

__all__ = ["findings", "overview", "summary"]


def findings(document: Mapping[str, Any]) -> dict[str, Any]:
    """Work out what the first screen says from the rest of the document."""
    return {
        "overview": overview(document),
        "references": list(_references(document["intervals"])),
        "cautions": cautions(document),
    }


def overview(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rows of the first table, and the sentences above them."""
    intervals = matching(document["intervals"], joint="marginal")
    best = {"method": METHODS[::-1], "family": families_of(document)}
    differences = compared_by_difference(intervals)
    rows = _rows(intervals, best, differences)
    # Paired as the methods are compared: in equal families.
    families = [row["family"] for row in rows] or list(best["family"])
    classical = _rows(intervals, {"method": ["classical"], "family": families}, differences)
    quantities = quantities_of(document)
    words = words_of(document)
    sentences = contrast_sentences(document)
    contrasts = len(sentences)
    sentences += _biases(rows, classical, quantities, words)
    if feelings := feeling_sentences(document["verdicts"], words):
        sentences.append(" ".join(feelings))
    sentences += _stability(document)
    sentences += _next_users(rows, quantities, words)
    # The next user's ranges answer where no device lets percept judge what feels real.
    most = contrasts + max(3, len(distinct(rows, "parameter")) + 2)
    return {"rows": rows, "sentences": sentences[:most]}


def _rows(
    intervals: Sequence[Record], best: Mapping[str, Sequence[str]], differences: set[str]
) -> list[dict[str, Any]]:
    """Return a row per environment and quantity, of the best method and family that it has."""
    rows = []
    for environment in distinct(intervals, "environment"):
        for parameter in distinct(intervals, "parameter"):
            alike = matching(intervals, environment=environment, parameter=parameter)
            row = _row(alike, best, relative=parameter not in differences)
            if row:
                rows.append(row)
    return rows


def _row(
    alike: Sequence[Record], best: Mapping[str, Sequence[str]], *, relative: bool
) -> dict[str, Any] | None:
    """Return what the table says of one quantity of one environment."""
    mean = first(matching(alike, kind="mean"), **best)
    user = first(matching(alike, kind=_KIND), **best)
    shown = mean or user
    if shown is None:
        return None
    reference = shown["reference"]

    def bias(interval: Record | None, name: str) -> float | None:
        value = None if interval is None else interval[name]
        if value is None or reference is None:
            return None
        size = float(value) / reference - 1.0 if relative else float(value) - reference
        return size if math.isfinite(size) else None

    row = {
        name: shown[name]
        for name in ("environment", "parameter", "unit", "reference", "method", "family", "level")
    }
    row["estimate"] = shown["estimate"]
    row["relative"] = relative
    row["bias"] = bias(shown, "estimate")
    for side in ("lower", "upper"):
        row[f"bias_{side}"] = bias(mean, side)
        row[f"user_{side}"] = None if user is None else user[side]
        row[f"user_bias_{side}"] = bias(user, side)
        row[f"user_{side}_ratio"] = None
        if user is not None and relative and row[f"user_bias_{side}"] is not None:
            row[f"user_{side}_ratio"] = float(user[side]) / reference
    return row


def _biases(
    rows: Sequence[Record],
    others: Sequence[Record],
    quantities: Mapping[str, Quantity],
    words: Words,
) -> list[str]:
    """Say for every quantity how far users set it off, with interval, method and level.

    `others` are the rows of the classical method; where they see another sign, that is said too.
    """
    sentences = []
    for parameter in distinct(rows, "parameter"):
        judged = [row for row in matching(rows, parameter=parameter) if _sign(row) is not None]
        if not judged:
            continue
        label = quantities[parameter].label
        said = _bias_sentence(judged, label[:1].upper() + label[1:], words)
        disagreeing = _disagreement(judged, matching(others, parameter=parameter))
        sentences.append(" ".join([said, *disagreeing]))
    return sentences


def _bias_sentence(judged: Sequence[Record], name: str, words: Words) -> str:
    claim = f"{METHOD_NAMES[judged[0]['method']]}, {percent(judged[0]['level'])}"
    if len(judged) == 1:
        row = judged[0]
        return f"{name} in {row['environment']}: {_signed(row)} ({claim}: {_bias_range(row)})."
    parts = []
    for sign, word in ((1, "high"), (-1, "low")):
        found = [row for row in judged if _sign(row) == sign]
        if found:
            parts.append(f"too {word} in {_sized(found, judged, words)}")
    if parts:
        return f"{name} is {', and '.join(parts)} ({claim})."
    largest = max(judged, key=lambda row: abs(row["bias"]))
    return (
        f"{name} shows no clear bias in any of {len(judged)} {words.environments} ({claim}); the"
        f" largest is that of {_with_range(largest)}."
    )


def _sign(row: Record) -> int | None:
    """Return the sign of a bias, 0 where its interval holds zero; None where there is no interval."""
    if row["bias"] is None or (row["bias_lower"] is None and row["bias_upper"] is None):
        return None
    if row["bias_lower"] is not None and row["bias_lower"] > 0:
        return 1
    return -1 if row["bias_upper"] is not None and row["bias_upper"] < 0 else 0


def _disagreement(judged: Sequence[Record], others: Sequence[Record]) -> list[str]:
    """Say where the classical interval sees another sign than the Bayesian one."""
    groups: dict[str, list[Record]] = {}
    for row in judged:
        other = first(matching(others, environment=row["environment"]), method=["classical"])
        if other is None or row["method"] == "classical" or _sign(other) in (None, _sign(row)):
            continue
        said = "holds zero" if _sign(other) == 0 else "excludes zero"
        groups.setdefault(said, []).append(other)
    sentences = []
    for said, rows in groups.items():
        if len(judged) == 1:
            sentences.append(f"The classical interval, {_bias_range(rows[0])}, {said}.")
            continue
        named = [f"{row['environment']} ({_bias_range(row)})" for row in rows[:_NAMED]]
        more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
        sentences.append(f"The classical interval {said} in {listed(named)}{more}.")
    return sentences


def _sized(rows: Sequence[Record], of: Sequence[Record], words: Words) -> str:
    """Give each environment its bias and interval; of many, the smallest and the largest."""
    if len(rows) <= _NAMED:
        return listed([_with_range(row) for row in rows])
    every = len(distinct(of, "environment"))
    count = f"all {every}" if len(rows) == every else f"{len(rows)} of {every}"
    by_size = sorted(rows, key=lambda row: abs(row["bias"]))
    ends = f"{_with_range(by_size[0])} to {_with_range(by_size[-1])}"
    return f"{count} {words.environments}, from {ends}"


def _with_range(row: Record) -> str:
    return f"{row['environment']} ({_signed(row)}, {_bias_range(row)})"


def _signed(row: Record) -> str:
    """Write the bias with its sign and unit."""
    number = _number(row["bias"], row)
    return f"{number}{_unit_of(row, row['bias'])}"


def _bias_range(row: Record) -> str:
    """Write the interval of the bias; an end without limit is infinite."""
    lower = -math.inf if row["bias_lower"] is None else row["bias_lower"]
    upper = math.inf if row["bias_upper"] is None else row["bias_upper"]
    units = [_unit_of(row, end) for end in (lower, upper)]
    first_unit = "" if units[0] == units[1] else units[0]
    return f"{_number(lower, row)}{first_unit} to {_number(upper, row)}{units[1]}"


def _number(value: float, row: Record) -> str:
    """Write a bias with its sign: in per cent of the reference, or as a multiple from ten on."""
    if row["relative"] and _MULTIPLE <= value < math.inf:
        return bare(rounded(1.0 + value, 3))
    size = abs(100.0 * value if row["relative"] else value)
    text = bare(rounded(size, 2))
    if row["relative"] and _LEAST_WHOLE <= size < math.inf:
        text = f"{size:.0f}"
    sign = "−" if value < 0 else "+"
    return text if text == "0" else f"{sign}{text}"


def _unit_of(row: Record, value: float) -> str:
    if not row["relative"]:
        return f" {row['unit']}" if row["unit"] else ""
    return " times" if _MULTIPLE <= value < math.inf else " %"


def _stability(document: Record) -> list[str]:
    coupling = document["coupling"]
    if not coupling or coupling.get("margin") is None:
        return []
    margin = float(coupling["margin"])
    has = f"{100 * margin:.2g} % of" if margin < 1 else f"{margin:.3g} times"
    poles = " The device is measured, so its poles cannot be checked."
    said = (
        f"The coupling is {coupling['verdict']}: the device has {has} the damping the coupling"
        " needs."
    )
    return [said + poles * ("poles cannot" in (coupling.get("reason") or ""))]


def _next_users(
    rows: Sequence[Record], quantities: Mapping[str, Quantity], words: Words
) -> list[str]:
    """Say where the next user's settings lie: in multiples of the reference, or how far from it."""
    sentences = []
    for parameter in distinct(rows, "parameter"):
        known = [
            row
            for row in matching(rows, parameter=parameter)
            if row["user_bias_lower"] is not None and row["user_bias_upper"] is not None
        ]
        if not known:
            continue
        by_width = sorted(known, key=lambda row: row["user_bias_upper"] - row["user_bias_lower"])
        if len(known) == 1:
            ranges = [_user_range(known[0])]
        else:
            narrowest = by_width[0]
            widest = by_width[-1]
            ranges = [
                f"{_user_range(narrowest)} ({narrowest['environment']}, the narrowest)",
                f"{_user_range(widest)} ({widest['environment']}, the widest)",
            ]
        sure = "confidence" if known[0]["method"] == "classical" else "probability"
        sentences.append(
            f"With {percent(known[0]['level'])} {sure}, the next {words.user}’s"
            f" {quantities[parameter].label} will be {' and '.join(ranges)}."
        )
    return sentences


def _digits_between(lower: float, upper: float) -> int:
    """Return the digits that tell two ends apart: two, and more where they lie close together."""
    width = upper - lower
    size = max(abs(lower), abs(upper))
    if not (0.0 < width < math.inf and 0.0 < size < math.inf):
        return 2
    decades = math.log10(size / width)
    return 2 if decades < 1.0 else min(2 + math.ceil(decades), 6)


def _user_range(row: Record) -> str:
    """Write the next user's range against the reference."""
    lower = row["user_bias_lower"]
    upper = row["user_bias_upper"]
    if row["relative"]:
        ratios = [row["user_lower_ratio"], row["user_upper_ratio"]]
        ends = [bare(rounded(ratio, _digits_between(*ratios))) for ratio in ratios]
        return f"{' to '.join(ends)} times the reference"
    ends = [bare(rounded(abs(end), 2)) for end in (lower, upper)]
    sides = ["below" if end < 0 else "above" for end in (lower, upper)]
    of = f" {row['unit']}" if row["unit"] else ""
    if sides[0] == sides[1]:
        nearer, farther = ends if lower >= 0 else ends[::-1]
        return f"{nearer} to {farther}{of} {sides[0]} the reference"
    return f"between {ends[0]}{of} below and {ends[1]}{of} above the reference"


def summary(document: Record) -> Section:
    """Return the first screen: sentences, the table of environments, and warnings."""
    shown = document["summary"]["overview"]
    verdicts = pointed(document["verdicts"], "/verdicts")
    rendered = distinct(verdicts, "coupled")
    rows = [
        {
            **row,
            "digits": digits_of(row["estimate"], row["user_lower"], row["user_upper"]),
            "rows": len(matching(shown["rows"], environment=row["environment"])),
            "real": [
                first(matching(verdicts, environment=row["environment"], coupled=coupled))
                for coupled in rendered
            ],
        }
        for row in pointed(shown["rows"], "/summary/overview/rows")
    ]
    values = {
        "sentences": shown["sentences"],
        "rows": rows,
        "panels": [f"overview_{name}" for name in distinct(rows, "parameter")],
        "rendered": [RENDERED[coupled] for coupled in rendered],
        "felt_method": verdicts[0]["method"] if verdicts else None,
        "method": rows[0]["method"] if rows else None,
        "family": rows[0]["family"] if rows else None,
        "data": document["data"],
        "quantities": quantities_of(document),
        "impedance": makes_impedance(document),
        "references": pointed(document["summary"]["references"], "/summary/references"),
        "cautions": document["summary"]["cautions"],
        "gate": (document["diagnostics"] or {}).get("gate"),
    }
    return Section("summary", "Summary", values)


def _references(intervals: list[Record]) -> Iterator[dict[str, Any]]:
    """Count, by method and family, the references inside the interval of the average user."""
    for method in METHODS:
        rows = matching(intervals, method=method, kind="mean", joint="marginal")
        rows = [row for row in rows if None not in (row["reference"], row["lower"], row["upper"])]
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
