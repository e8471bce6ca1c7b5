"""The sections of the page on what its results rest on, each from the document, and what they cite."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache, reduce
from importlib import resources
from typing import Any

from percept import __version__
from percept.report.cautions import misfits
from percept.report.numbers import bare, percentage, rounded
from percept.report.select import (
    KINDS,
    METHODS,
    Record,
    Section,
    compared_by_difference,
    distinct,
    escaped,
    family_of,
    listed,
    makes_impedance,
    pointed,
    quantities_of,
    words_of,
)
from percept.sessions.quantities import Quantity

__all__ = ["bibtex", "checks", "cited", "comparison", "data", "diagnostics", "methods"]


def comparison(document: Record) -> Section | None:
    """Return pairs of intervals and of curves, with how classical and Bayesian differ, and why."""
    rows = document["comparison"]
    if not rows:
        return None
    quantities = quantities_of(document).values()
    values = {
        "families": distinct(rows, "family"),
        "methods": METHODS,
        "units": listed([f"{q.symbol} in {q.unit or 'its own unit'}" for q in quantities]),
        "sentence": _apart(rows, quantities_of(document)),
        "ladder": document["ladder"],
        "rows": rows,
    }
    return Section("comparison", "Classical against Bayesian", values)


def _apart(rows: Sequence[Record], quantities: Mapping[str, Quantity]) -> str:
    """Say in two sentences how far the methods lie apart."""
    ratios = [float(row["width_ratio"]) for row in rows if row.get("width_ratio") is not None]
    shifted = [row for row in rows if row.get("shift") is not None]
    if not ratios or not shifted:
        return ""
    farthest: dict[str | None, float] = {}  # By quantity; None for all whose shift is a fraction
    for row in shifted:
        name = None if row["relative"] else row["parameter"]
        farthest[name] = max(farthest.get(name, 0.0), abs(float(row["shift"])))
    apart = []
    for name, size in farthest.items():
        if name is None:
            apart.append(percentage(size, 2))
        else:
            apart.append(f"{bare(rounded(size, 2))} {quantities[name].unit}".strip())
    least = bare(rounded(min(ratios), 2))
    most = bare(rounded(max(ratios), 2))
    wide = f"{least} times" if least == most else f"{least} to {most} times"
    return (
        f"Of the same family and kind, Bayesian intervals are {wide} as wide as classical ones. "
        f"Their estimates lie at most {listed(apart)} apart."
    )


_GATE = (
    ("rhat", "Rank R̂ across ensembles, largest", "below 1.01", 5),
    ("autocorrelation_time", "Autocorrelation time, longest (steps)", "finite", 4),
    ("times_run", "Length of a kept run in autocorrelation times", "10 or more", 4),
    ("effective_draws", "Effective draws, fewest", "", 5),
    ("acceptance", "Fraction of proposals accepted", "", 3),
    (
        "worst_error",
        "Monte Carlo error of the Bayesian intervals’ limits, largest (half-widths)",
        "within the tolerance",
        3,
    ),
)


def diagnostics(document: Record) -> Section | None:
    """Return the gate's verdict on the sampler, the measures behind it, and the priors in force."""
    record = document["diagnostics"]
    if not record:
        return None
    gate = record["gate"]
    measures = []
    for name, label, asked, digits in _GATE:
        if isinstance(gate[name], (int, float)):
            pointer = f"/diagnostics/gate/{name}"
            measures.append({"label": label, "asked": asked, "pointer": pointer, "digits": digits})
    values = {
        "gate": gate,
        "measures": measures,
        "priors": record.get("priors", []),
    }
    return Section("diagnostics", "Sampling and its checks", values)


#: Tables of the checks by where they stand under /checks, with what each says.
_CHECKS = {
    "normality": (
        "Shapiro–Wilk tests of the values of the {subjects} (normal) and of their logarithms"
        " (lognormal): what the classical intervals of each family assume. With ten {subjects} only"
        " gross misfit shows."
    ),
    "loo/subjects": (
        "Each {subject} left out: log predictive density given the others, Pareto index of "
        "leaving it out, and the probability of lying as far off or farther."
    ),
    "statistics": (
        "Mean and SD over {subjects} (response scale) and the farthest {subject} (in SDs), against new "
        "studies drawn from the posterior."
    ),
    "prior": (
        "What the priors alone say, before any data: quantiles of the average and the next {user}."
    ),
}
_HEADS = {
    "elpd": "log density", "pareto_k": "Pareto index", "farther": "as far or farther", "p_value": "p",
    "above": "probability of more",
}  # fmt: skip
#: What the messages above the tables say.
_UNSHOWN = {"influential", "outlier", "unusual"}


def checks(document: Record) -> Section | None:
    """Return the checks of the hierarchical model as messages and tables, where they were asked for."""
    record = document.get("checks")
    if not record:
        return None
    tables = []
    words = words_of(document)
    for steps, caption in _CHECKS.items():
        rows: Any = reduce(lambda inner, step: inner and inner.get(step), steps.split("/"), record)
        if rows:
            rows = [_flat(row) for row in rows]
            heads = {
                name: _HEADS.get(name, re.sub("quantiles/(.*)", r"\1 %", name))
                for name in rows[0]
                if name not in _UNSHOWN
            }
            table = {
                "caption": caption.format(**vars(words)),
                "pointer": f"/checks/{steps}",
                "heads": heads,
            }
            tables.append({**table, "rows": rows})
    bayesian = record.get("loo") is not None
    values = {
        "messages": list(misfits(record, words)) if bayesian else [],
        "tables": tables,
        "bayesian": bayesian,
    }
    return Section("checks", "Checks of the model", values)


def _flat(row: Record) -> Record:
    """Give each quantile of a row a name of its own, by its pointer below the row."""
    quantiles = row.get("quantiles", {})
    flat = {name: value for name, value in row.items() if name != "quantiles"}
    return flat | {f"quantiles/{name}": value for name, value in quantiles.items()}


def data(document: Record) -> Section:
    """Return what was read, and what was left out."""
    record = document["data"]
    subject, subjects = record["words"]["subject"]
    environment, environments = record["words"]["environment"]
    labels = {
        "subjects": subjects,
        "environments": environments,
        "empty cells (subject × environment)": f"empty cells ({subject} × {environment})",
    }
    counts = [
        {"what": labels.get(what, what), "pointer": f"/data/counts/{escaped(what)}"}
        for what in record["counts"]
    ]
    values = {"data": record, "counts": counts, "cells": pointed(record["cells"], "/data/cells")}
    return Section("data", "Data", values)


_CLASSICAL = {
    "mean": "t-intervals of the mean",
    "user": "prediction intervals of the next {0}",
    "share": "exact two-sided tolerance intervals",
}
_LEVEL = "/provenance/scene/inference/level"
_SHARE = "/provenance/scene/inference/share"


def methods(document: Record) -> Section:
    """Return what the methods paragraph depends on, and what it cites."""
    scene = document["provenance"]["scene"]
    intervals = document["intervals"]
    used = {row["method"] for row in intervals}
    kinds = [kind for kind in KINDS if kind in {row["kind"] for row in intervals}]
    references = cited(document)
    values = {
        "data": document["data"],
        "quantities": quantities_of(document),
        "impedance": makes_impedance(document),
        "boundaries": bool(document["boundaries"]),
        "worst": worst_curve(document["boundaries"]),
        "missed": (document["diagnostics"] or {}).get("gate", {}).get("tolerance_met") is False,
        "device": scene.get("device"),
        "coupling": scene.get("coupling") if document["coupling"] else None,
        "family": family_of(document),
        "deviation": _deviation(document),
        "kinds": kinds,
        "classical": "classical" in used,
        "classical_kinds": listed(
            [_CLASSICAL[kind].format(document["data"]["words"]["user"][0]) for kind in kinds]
        ),
        "share_pointer": _SHARE if "share" in scene["inference"] else _LEVEL,
        "bayesian": "bayesian" in used,
        "model": _model(document),
        "pooled": scene.get("model", {}).get("pooling", "partial") == "partial",
        "contrast": document.get("contrast"),
        "subjects": max((row["n"] for row in intervals), default=0),
        "references": references,
        "numbers": {reference["key"]: rank for rank, reference in enumerate(references, start=1)},
        "bibtex": bibtex(document),
    }
    return Section("methods", "Methods, ready to paste", values)


def _deviation(document: Record) -> str:
    """Say what the responses of the normal family are."""
    quantities = quantities_of(document)
    differences = compared_by_difference(document["intervals"])
    scales = document["provenance"]["scene"].get("model", {}).get("scale", {})
    labels = {name: quantity.label for name, quantity in quantities.items()}
    parts = []
    if relative := [label for name, label in labels.items() if name not in differences]:
        of = "" if not differences else f" ({' and '.join(relative)})"
        parts.append(f"relative deviation of the adjustment from the reference{of}")
    for name in (name for name in quantities if name in differences and name in scales):
        of = f" of {labels[name]}" if relative or len(differences) > 1 else ""
        size = quantities[name].amount(scales[name])
        parts.append(f"difference{of} between adjustment and reference in steps of {size}")
    return " and ".join(parts)


def worst_curve(boundaries: Sequence[Record]) -> dict[str, Any] | None:
    """Name the curve through draws with the largest typical Monte Carlo error; None without such curves."""
    drawn = [
        record for record in pointed(boundaries, "/boundaries") if record.get("error") is not None
    ]
    if not drawn:
        return None
    worst = max(drawn, key=lambda record: float(record["error"]))
    labels = {name: worst[name] for name in ("environment", "kind", "method", "family")}
    return labels | {"pointer": f"{worst['pointer']}/error"}


def _model(document: Record) -> str:
    """Say what the hierarchical model is made of; data and scene leave parts of it out."""
    record = document["data"]
    model = document["provenance"]["scene"].get("model", {})
    words = words_of(document)
    quantities = quantities_of(document)
    parameters = distinct(document["intervals"], "parameter")
    names = [quantities[parameter].label for parameter in parameters]
    pair = len(names) == 2
    sessions = record["form"] == "trials"
    several = len(record["environments"]) > 1
    parts = ["a bias"]
    if several:
        parts = [
            "a regression of bias on the logarithm of the reference with a deviation for each"
            f" {words.environment}"
        ]
    if sessions and several and model.get("subject_effect", True):
        both = f" and correlated between {' and '.join(names)}" if pair else ""
        parts.append(f"{words.subject} effects shared by all {words.environments}{both}")
    scatter = f"between-{words.subject} scatter"
    if several:
        alike = model.get("common_spread")
        scatter += (
            f" alike in all {words.environments}" if alike else f" within each {words.environment}"
        )
    if several and model.get("weber"):
        scatter += (
            f", in proportion to the reference but for each {words.environment}’s own deviation"
        )
    by_itself = f" ({' and '.join(names)} each by itself)" if pair and not sessions else ""
    return f"{', '.join(parts)}, and {scatter}{by_itself}"


@cache
def _references() -> tuple[Record, ...]:
    """Return works to cite: key, entry type and fields of BibTeX, and the text for a list."""
    text = resources.files("percept.report").joinpath("references.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text.replace("{version}", __version__))
    return tuple({"key": key, **table} for key, table in tables.items())


def cited(document: Record) -> list[Record]:
    """Return what the methods paragraph of a document cites, in order."""
    methods = {row["method"] for row in document["intervals"]}
    needed = {"percept"} | ({"boundaries"} if makes_impedance(document) else set())
    if "classical" in methods:
        needed.add("meeker2017")
    if "bayesian" in methods:
        needed |= {"emcee", "cotter2013", "vehtari2021"}
    if document["provenance"]["scene"].get("coupling") and makes_impedance(document):
        needed.add("adams1999")
    return [reference for reference in _references() if reference["key"] in needed]


def bibtex(document: Record) -> str:
    """Return the BibTeX entries of what a document cites."""
    entries = []
    for reference in cited(document):
        fields = ",\n".join(
            f"  {name} = {{{value}}}" for name, value in reference["fields"].items()
        )
        entries.append(f"@{reference['entry']}{{{reference['key']},\n{fields}\n}}\n")
    return "\n".join(entries)
