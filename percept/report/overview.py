"""The answer first: the findings in a few sentences, and a row for every quantity of every environment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from percept.report.numbers import bare, rounded
from percept.report.select import (
    KINDS,
    METHODS,
    Record,
    Section,
    distinct,
    families_of,
    first,
    makes_impedance,
    matching,
    pointed,
    quantities_of,
)

#: More names than this are counted, not listed.
_NAMED = 5
_KIND = "user"  # whose boundary decides whether an environment feels real


def overview(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rows of the first table, how real each environment feels, and the sentences above them.

    A row's numbers come from the Bayesian intervals of the study's family where there are any. `bias` is the
    estimate over the reference, less one; a reference of zero has none.
    """
    rows = [row for cell in _cells(document) if (row := _row(document, *cell))]
    realism = _realism(document)
    labels = {name: quantity.label for name, quantity in quantities_of(document).items()}
    sentences = [*_biases(rows, labels), *_feelings(realism), *_stability(document)]
    sentences += _next_users(rows, labels)
    # The next user's ranges answer where no device lets percept judge what feels real.
    return {"rows": rows, "realism": realism, "sentences": sentences[: max(3, len(_parameters(rows)) + 2)]}


def _cells(document: Record) -> list[tuple[str, str]]:
    intervals = document["intervals"]
    return [
        (environment, parameter)
        for environment in distinct(intervals, "environment")
        for parameter in distinct(intervals, "parameter")
    ]


def _parameters(rows: Iterable[Record]) -> list[str]:
    return distinct(rows, "parameter")


def _row(document: Record, environment: str, parameter: str) -> dict[str, Any] | None:
    """Return what the table says of one quantity of one environment."""
    alike = matching(document["intervals"], environment=environment, parameter=parameter, joint="marginal")
    best = {"method": METHODS[::-1], "family": families_of(document)}
    mean, user = (first(matching(alike, kind=kind), **best) for kind in ("mean", _KIND))
    shown = mean or user
    if shown is None:
        return None
    row: dict[str, Any] = {
        name: shown[name] for name in ("environment", "parameter", "unit", "reference", "method", "family")
    }
    row |= {"estimate": shown["estimate"], "bias": _over(shown, "estimate")}
    row |= {f"bias_{side}": _over(mean, side) for side in ("lower", "upper")}
    row |= {f"user_{side}": None if user is None else user[side] for side in ("lower", "upper")}
    row |= {f"user_{side}_ratio": _ratio(user, side) for side in ("lower", "upper")}
    return row


def _ratio(interval: Record | None, name: str) -> float | None:
    if interval is None or not interval["reference"] or interval[name] is None:
        return None
    ratio = float(interval[name]) / float(interval["reference"])
    return ratio if math.isfinite(ratio) else None


def _over(interval: Record | None, name: str) -> float | None:
    ratio = _ratio(interval, name)
    return None if ratio is None else ratio - 1.0


def _realism(document: Record) -> list[dict[str, Any]]:
    """Return whether each reference stays inside the next user's boundary at every ω, directly and coupled.

    The boundary is the exact envelope in the study's family, Bayesian where there is one. A departure is the
    largest distance outside it, as a fraction of the boundary's curve; `plane_departure` is that of effective
    stiffness and damping, in widths of their limits. `breaks` names what an inadmissible coupling breaks.
    """
    coupling = document["coupling"] or {}
    records = matching(coupling.get("realism") or (), kind=_KIND, shape="envelope")
    records = [record for record in records if record["joint"] == "marginal"]
    best = {"method": METHODS[::-1], "family": families_of(document)}
    chosen = [first(matching(records, environment=name), **best) for name in distinct(records, "environment")]
    return [
        {"environment": record["environment"], "method": record["method"], "family": record["family"]}
        | {
            rendered: {
                "verdict": record[f"verdict_{side}"],
                "departure": max(0.0, record[f"departure_{side}"]),
                "omega": record[f"departure_omega_{side}"],
                "plane_departure": record[f"plane_departure_{side}"],
            }
            for rendered, side in (("directly", "uncoupled"), ("coupled", "coupled"))
        }
        | {"breaks": _breaks(coupling["verdict"], record)}
        for record in chosen
        if record is not None
    ]


def _breaks(stability: str, record: Record) -> list[str]:
    """Name the criteria that the scene's coupling breaks for an environment; none of an admissible one."""
    broken = {
        "stability": stability != "stable",
        "magnitude": record["verdict_coupled"] == "outside",
        "plane": record["plane_departure_coupled"] > 0.0,
    }
    return [name for name, is_broken in broken.items() if is_broken]


def _biases(rows: Sequence[Record], labels: Mapping[str, str]) -> list[str]:
    """Say for every quantity where users set too much and where too little."""
    several = len(distinct(rows, "environment")) > 1
    sentences = []
    for parameter in _parameters(rows):
        known = [row for row in matching(rows, parameter=parameter) if row["bias"] is not None]
        clear = [row for row in known if row["bias_lower"] is not None and row["bias_upper"] is not None]
        high = [row for row in clear if row["bias_lower"] > 0]
        low = [row for row in clear if row["bias_upper"] < 0]
        name = labels[parameter][:1].upper() + labels[parameter][1:]
        parts = [
            f"{_sizes(found)} too {word}{f' in {_names(found, clear)}' if several else ''}"
            for word, found in (("high", high), ("low", low))
            if found
        ]
        if parts:
            sentences.append(f"{name} is set {' and '.join(parts)}.")
        elif clear:
            every = f" in any of {len(clear)} environments" if several else ""
            sentences.append(f"{name} shows no clear bias{every}.")
    return sentences


def _sizes(rows: Sequence[Record]) -> str:
    sizes = sorted(abs(row["bias"]) for row in rows)
    shown = [_size(size) for size in (sizes[0], sizes[-1])]
    if shown[0] == shown[1]:
        return shown[0]
    return f"{shown[0].removesuffix(' %')} to {shown[1]}" if shown[1].endswith("%") else " to ".join(shown)


def _size(size: float) -> str:
    """Write the size of a bias: a percentage of two digits, a multiple from ten times the reference on."""
    if size >= 9.0:
        return f"{bare(rounded(1.0 + size, 3))} times"
    return (
        "less than 0.1 %"
        if size < 0.001
        else f"{100.0 * size:.2g} %"
        if size < 0.995
        else f"{100 * size:.0f} %"
    )


def _names(rows: Sequence[Record], of: Sequence[Record]) -> str:
    names = distinct(rows, "environment")
    return listed(names) if len(names) <= _NAMED else f"{len(names)} of {len(distinct(of, 'environment'))}"


def listed(names: Sequence[str]) -> str:
    """Join names with commas and a final "and"."""
    return " and ".join(text for text in (", ".join(names[:-1]), *names[-1:]) if text)


def _feelings(realism: Sequence[Record]) -> list[str]:
    """Say which references stay inside the next user's boundary through the coupling."""
    groups = {
        "inside": ("stays inside {}", "stay inside {}"),
        "marginal": ("touches the limits of {}", "touch the limits of {}"),
        "outside": ("leaves {}", "leave {}"),
    }
    parts: list[str] = []
    for verdict, said in groups.items():
        if found := [record for record in realism if record["coupled"]["verdict"] == verdict]:
            boundary = "it" if parts else "the next user’s boundary"
            parts.append(f"{_names(found, realism)} {said[len(found) > 1].format(boundary)}")
            if verdict == "outside":
                most = max(record["coupled"]["departure"] for record in found)
                parts[-1] += f" by up to {_size(most)}"
    return [f"Through the coupling, {'; '.join(parts)}."] if parts else []


def _stability(document: Record) -> list[str]:
    coupling = document["coupling"]
    if not coupling or coupling.get("margin") is None:
        return []
    margin = float(coupling["margin"])
    has = f"{100 * margin:.2g} % of" if margin < 1 else f"{margin:.3g} times"
    poles = " The device is measured, so its poles cannot be checked."
    return [
        f"The coupling is {coupling['verdict']}: the device has {has} the damping the coupling needs."
        + poles * ("poles cannot" in (coupling.get("reason") or ""))
    ]


def _next_users(rows: Sequence[Record], labels: Mapping[str, str]) -> list[str]:
    """Say between which multiples of the reference the next user's settings lie."""
    sentences = []
    for parameter in _parameters(rows):
        known = [
            row
            for row in matching(rows, parameter=parameter)
            if row["user_lower_ratio"] is not None and row["user_upper_ratio"] is not None
        ]
        if not known:
            continue
        by_width = sorted(known, key=lambda row: row["user_upper_ratio"] - row["user_lower_ratio"])
        shown = by_width[-1:] if len(known) == 1 else [by_width[0], by_width[-1]]
        ranges = [
            " to ".join(bare(rounded(row[f"user_{side}_ratio"], 2)) for side in ("lower", "upper"))
            + " times the reference"
            + (f" ({row['environment']}, the {extreme})" if len(known) > 1 else "")
            for row, extreme in zip(shown, ("narrowest", "widest"), strict=False)
        ]
        sentences.append(f"The next user sets {labels[parameter]} to {' and '.join(ranges)}.")
    return sentences


def summary(document: Record) -> Section:
    """Return the first screen: sentences, the table of environments, and warnings."""
    shown = document["summary"]["overview"]
    realism = {
        record["environment"]: record for record in pointed(shown["realism"], "/summary/overview/realism")
    }
    rendered = [name for name in ("directly", "coupled") if any(name in row for row in realism.values())]
    rows = [
        {
            **row,
            "digits": digits_of(row["estimate"], row["user_lower"], row["user_upper"]),
            "rows": len(matching(shown["rows"], environment=row["environment"])),
            "real": [_rendered(realism.get(row["environment"]), name) for name in rendered],
        }
        for row in pointed(shown["rows"], "/summary/overview/rows")
    ]
    values = {
        "sentences": shown["sentences"],
        "rows": rows,
        "panels": [f"overview_{name}" for name in _parameters(rows)],
        "rendered": rendered,
        "realism": bool(rendered),
        "method": rows[0]["method"] if rows else None,
        "family": rows[0]["family"] if rows else None,
        "data": document["data"],
        "quantities": quantities_of(document),
        "impedance": makes_impedance(document),
        "references": _references(document),
        "widths": _widths(document),
        "laws": _laws(document),
        "cautions": document["summary"]["cautions"],
        "gate": (document["diagnostics"] or {}).get("gate"),
    }
    return Section("summary", "Summary", values)


def _rendered(record: Record | None, name: str) -> dict[str, Any] | None:
    if record is None or name not in record:
        return None
    return {**record[name], "pointer": f"{record['pointer']}/{name}"}


def digits_of(value: float | str | None, lower: float | str | None, upper: float | str | None) -> int:
    """Return the significant digits worth reading: to about a hundredth of an interval's half-width."""
    limits = [float(limit) for limit in (lower, upper) if limit is not None]
    width = max(limits, default=0.0) - min(limits, default=0.0)
    size = abs(float(value)) if value is not None else 0.0
    if not (0.0 < width < math.inf and 0.0 < size < math.inf):
        return 4
    return min(max(math.ceil(math.log10(size / (0.005 * width))), 2), 6)


def _widths(document: Record) -> list[Record]:
    """Return, per parameter, the widths of one kind and method: the next user's, Bayesian if there is one."""
    rows = pointed(document["summary"]["widths"], "/summary/widths")
    quantities = quantities_of(document)
    preferred = (
        first(
            matching(rows, parameter=parameter),
            kind=("user", "mean", "share"),
            method=("bayesian", "classical"),
            family=families_of(document),
        )
        for parameter in quantities
    )
    return [{**row, "name": quantities[row["parameter"]].label} for row in preferred if row is not None]


def _references(document: Record) -> list[dict[str, Any]]:
    """Return the counts of references inside their intervals; families that agree share a sentence."""
    sentences: dict[Any, dict[str, Any]] = {}
    for row in pointed(document["summary"]["references"], "/summary/references"):
        outside = tuple((cell["environment"], cell["parameter"]) for cell in row["outside"])
        key = (row["method"], row["level"], row["inside"], row["of"], outside)
        sentences.setdefault(key, {**row, "families": []})["families"].append(row["family"])
    return list(sentences.values())


def _laws(document: Record) -> list[Record]:
    """Return the laws to quote: the best predictors for the average user, Bayesian if there are any."""
    every, quantities = (document["band"] or {}).get("laws") or (), quantities_of(document)
    found = list[Record]()
    for parameter in dict.fromkeys(law.get("parameter") for law in every):
        laws = matching(every, parameter=parameter)
        preferred = first(laws, kind=KINDS, method=("bayesian", "classical"), family=families_of(document))
        if preferred is not None:
            alike = matching(laws, **{name: preferred[name] for name in ("kind", "method", "family")})
            best = min(alike, key=lambda law: (law["left_out_error"] is None, law["left_out_error"]))
            size = "impedance" if parameter is None else f"the reference {quantities[parameter].label}"
            found.append({**best, "size": size})
    return found
