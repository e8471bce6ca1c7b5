"""Checks of the hierarchical model: subjects left out, predictions, pooling, priors, smaller models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from percept.report.sections.part import Part


@dataclass(frozen=True)
class _Table:
    """A table of the document: what it shows, in words and in numbers."""

    place: str  # Where it stands under /checks
    caption: str  # What it says
    words: Mapping[str, str]  # Heads of the columns of text
    numbers: Mapping[str, tuple[str, int, str]]  # Heads of the columns of numbers, their digits and style


def _plain(digits: int, **heads: str) -> dict[str, tuple[str, int, str]]:
    return {name: (head, digits, "plain") for name, head in heads.items()}


_CELL = {"environment": "Environment", "parameter": "Parameter"}
_SIGN = {
    **_plain(2, lower="lower", value="mean", upper="upper"),
    **_plain(3, positive="probability above 0"),
}
_TABLES = (
    _Table(
        "loo/subjects",
        "Each subject left out: log predictive density given the others, Pareto index of leaving it out, and "
        "the probability of lying as far off or farther.",
        {"subject": "Subject"},
        {**_plain(4, elpd="log density"), **_plain(2, pareto_k="Pareto index", farther="as far or farther")},
    ),
    _Table(
        "models/table",
        "Smaller models by the log predictive density of subjects left out, with standard errors.",
        {"model": "Model"},
        {
            **_plain(4, elpd="log density"),
            **_plain(2, se="error"),
            **_plain(3, difference="to the first"),
            **_plain(2, difference_se="error"),
            "rough": ("rough", 3, "count"),
        },
    ),
    _Table(
        "statistics",
        "Mean and SD over subjects (response scale) and the farthest subject (in SDs), against new studies "
        "drawn from the posterior.",
        {**_CELL, "statistic": "Statistic"},
        {
            **_plain(3, observed="observed", lower="lower", upper="upper"),
            **_plain(2, above="probability of more"),
        },
    ),
    _Table(
        "shrinkage",
        "Centres before and after pooling, in N/m (k) and N·s/m (b), and the share of the way from the raw "
        "mean to the trend over environments that they moved.",
        _CELL,
        {**_plain(4, raw="raw mean", centre="centre", trend="trend"), "moved": ("moved", 2, "percent")},
    ),
    _Table(
        "correlation",
        "Correlation of k and b between users: of the deviations within an environment, of the effect "
        "shared by all, and of the population of each environment.",
        {"of": "Of", "environment": "Environment"},
        _SIGN,
    ),
    _Table(
        "weber",
        "κ, the change of log spread per decade of the reference; zero is Weber's law.",
        {"parameter": "Parameter"},
        _SIGN,
    ),
    _Table(
        "sensitivity",
        "Sensitivity of the posterior of the average user, the next user and the spread to raising priors or "
        "likelihood to a power; from 0.05 on it is worth a look.",
        {**_CELL, "quantity": "Of", "diagnosis": "Diagnosis"},
        _plain(2, prior="priors", likelihood="likelihood"),
    ),
    _Table(
        "prior",
        "What the priors alone say, before any data: quantiles of the average and the next user, in N/m (k) "
        "and N·s/m (b).",
        {**_CELL, "kind": "Kind"},
        _plain(3, **{f"q{share}": f"{share} %" for share in ("0.5", "5", "25", "50", "75", "95", "99.5")}),
    ),
)


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the checks that were asked for, as messages and tables."""
    checks = document.get("checks")
    if not checks:
        return None
    tables = [
        {**vars(table), "place": f"/checks/{table.place}", "rows": rows}
        for table in _TABLES
        if (rows := _rows(checks, table.place))
    ]
    messages = list(checks["loo"]["messages"])
    refitted = [row["subject"] for row in checks["loo"]["subjects"] if row["refitted"]]
    if refitted:
        messages.append(f"Sampled anew without each of {', '.join(refitted)}: their rows below are exact.")
    if checks["models"]:
        messages += [checks["models"]["sentence"], *checks["models"]["failed"]]
    unusual = [row for row in checks["statistics"] if row["unusual"]]
    messages += [
        f"The {row['statistic']} of {row['parameter']} in {row['environment']} is unusual for the model."
        for row in unusual
    ]
    return Part("checks", "Checks of the model", {"messages": messages, "tables": tables})


def _rows(checks: Mapping[str, Any], place: str) -> list[Mapping[str, Any]] | None:
    found: Any = checks
    for step in place.split("/"):
        found = found[step] if found else None
    return found
