"""Classical against Bayesian, with what sets them apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part
from percept.report.select import METHODS, distinct, each_by_itself

_MEASURES = {
    "width_ratio": ("width ratio", "Bayesian width over classical width"),
    "shift": ("shift", "how far the Bayesian estimate stands from the classical one"),
    "overlap": ("overlap", "what both intervals hold, over what they span together"),
}
_REASONS = {
    "spread_ratio": (
        "spread",
        "posterior SD between users over the sample's: an environment's spread is drawn towards the others'",
    ),
    "certainty_ratio": (
        "certainty",
        "half-widths in their own SDs, Bayesian over classical: what is gained by knowing SD and mean "
        "better; times the spread it is the width ratio, on the family's scale",
    ),
    "shift_sds": ("shift in SDs", "of the centre, in sample SDs: pull towards the trend over environments"),
    "prior_lower": (
        "priors, lower",
        "how far the lower limit lies from where priors a quarter wider would put it, in half-widths",
    ),
    "prior_upper": ("priors, upper", "the same for the upper limit"),
    "scale_ratio": ("scale", "classical width in the other family over the width in this one"),
    "to_mean_classical": ("covers, classical", "width over that of kind mean: what is covered"),
    "to_mean_bayesian": ("covers, Bayesian", "the same, Bayesian"),
}
_PERCENTAGES = ("shift", "overlap")


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the pairs of intervals with measures of how they differ and of why, and the pairs of curves."""
    rows = document["comparison"]
    if not rows:
        return None
    return Part(
        "comparison",
        "Classical against Bayesian",
        {
            "families": distinct(rows, "family"),
            "methods": METHODS,
            "measures": _columns(rows, _MEASURES),
            "reasons": _columns(rows, _REASONS),
            "rows": rows,
            "curves": _curves(document["curve_comparison"]),
        },
    )


def _curves(rows: list[dict[str, Any]]) -> list[dict[str, str]]:
    return [
        {
            "environment": row["environment"],
            "kind": row["kind"],
            "shape": row["shape"],
            "place": f"/curve_comparison/{i}",
        }
        for i, row in enumerate(rows)
        if each_by_itself(row)
    ]


def _columns(rows: list[dict[str, Any]], known: Mapping[str, tuple[str, str]]) -> list[dict[str, str]]:
    return [
        {
            "name": name,
            "head": head,
            "meaning": meaning,
            "style": "percent" if name in _PERCENTAGES else "plain",
        }
        for name, (head, meaning) in known.items()
        if name in rows[0]
    ]
