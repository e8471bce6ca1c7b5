"""Checks of the hierarchical model: subjects left out, predictions, pooling, priors, smaller models."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]

#: Per table: where it stands under /checks, caption, columns of words with their heads, and columns of
#: numbers with heads, digits and style.
_TABLES: tuple[tuple[str, str, dict[str, str], dict[str, tuple[str, int, str]]], ...] = (
    (
        "loo/subjects",
        "Each subject left out: log predictive density given the others, Pareto index of leaving it out, and "
        "the probability of lying as far off or farther.",
        {"subject": "Subject"},
        {
            "elpd": ("log density", 4, "plain"),
            "pareto_k": ("Pareto index", 2, "plain"),
            "farther": ("as far or farther", 2, "plain"),
        },
    ),
    (
        "models/table",
        "Smaller models by the log predictive density of subjects left out, with standard errors.",
        {"model": "Model"},
        {
            "elpd": ("log density", 4, "plain"),
            "se": ("error", 2, "plain"),
            "difference": ("to the first", 3, "plain"),
            "difference_se": ("error", 2, "plain"),
            "rough": ("rough", 3, "count"),
        },
    ),
    (
        "statistics",
        "Mean and SD over subjects (response scale) and the farthest subject (in SDs), against new studies "
        "drawn from the posterior.",
        {"environment": "Environment", "parameter": "Parameter", "statistic": "Statistic"},
        {
            "observed": ("observed", 3, "plain"),
            "lower": ("lower", 3, "plain"),
            "upper": ("upper", 3, "plain"),
            "above": ("probability of more", 2, "plain"),
        },
    ),
    (
        "shrinkage",
        "Centres before and after pooling, in N/m (k) and N·s/m (b), and the share of the way from the raw "
        "mean to the trend over environments that they moved.",
        {"environment": "Environment", "parameter": "Parameter"},
        {
            "raw": ("raw mean", 4, "plain"),
            "centre": ("centre", 4, "plain"),
            "trend": ("trend", 4, "plain"),
            "moved": ("moved", 2, "percent"),
        },
    ),
    (
        "correlation",
        "Correlation of k and b between users: of the deviations within an environment, of the effect "
        "shared by all, and of the population of each environment.",
        {"of": "Of", "environment": "Environment"},
        {
            "lower": ("lower", 2, "plain"),
            "value": ("mean", 2, "plain"),
            "upper": ("upper", 2, "plain"),
            "positive": ("probability above 0", 3, "plain"),
        },
    ),
    (
        "weber",
        "κ, the change of log spread per decade of the reference; zero is Weber's law.",
        {"parameter": "Parameter"},
        {
            "lower": ("lower", 2, "plain"),
            "value": ("mean", 2, "plain"),
            "upper": ("upper", 2, "plain"),
            "positive": ("probability above 0", 3, "plain"),
        },
    ),
    (
        "sensitivity",
        "Sensitivity of the posterior of the average user, the next user and the spread to raising priors or "
        "likelihood to a power; from 0.05 on it is worth a look.",
        {"environment": "Environment", "parameter": "Parameter", "quantity": "Of", "diagnosis": "Diagnosis"},
        {"prior": ("priors", 2, "plain"), "likelihood": ("likelihood", 2, "plain")},
    ),
    (
        "prior",
        "What the priors alone say, before any data: quantiles of the average and the next user, in N/m (k) "
        "and N·s/m (b).",
        {"environment": "Environment", "parameter": "Parameter", "kind": "Kind"},
        {
            f"q{share}": (f"{share} %", 3, "plain")
            for share in ("0.5", "5", "25", "50", "75", "95", "99.5")
        },
    ),
)  # fmt: skip


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the checks that were asked for, as messages and tables.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    checks = document.get("checks")
    if not checks:
        return None
    tables = [
        {"place": f"/checks/{place}", "caption": caption, "words": words, "numbers": numbers, "rows": rows}
        for place, caption, words, numbers in _TABLES
        if (rows := _rows(checks, place))
    ]
    messages = list(checks["loo"]["messages"])
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
