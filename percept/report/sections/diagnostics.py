"""The sampler's diagnostics, the gate, and the priors in force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

_MEASURES = (
    ("rhat", "Rank R̂ across ensembles, largest", "below 1.01", 5),
    ("autocorrelation_time", "Autocorrelation time, longest (steps)", "finite", 4),
    ("times_run", "Length of a kept run in autocorrelation times", "10 or more", 4),
    ("effective_draws", "Effective draws, fewest", "", 5),
    ("acceptance", "Share of proposals accepted", "", 3),
    (
        "worst_error",
        "Monte Carlo error of the Bayesian intervals’ limits, largest (half-widths)",
        "within the tolerance",
        3,
    ),
)
_COUNTS = ("ensembles", "walkers", "steps")


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the gate's verdict, the measures behind it, and the priors."""
    diagnostics = document["diagnostics"]
    if not diagnostics:
        return None
    gate = diagnostics["gate"]
    measures = [
        {"label": label, "asked": asked, "place": f"/diagnostics/gate/{name}", "digits": digits}
        for name, label, asked, digits in _MEASURES
        if isinstance(gate.get(name), (int, float))
    ]
    counts = [
        {"label": name, "place": f"/diagnostics/{name}"}
        for name in _COUNTS
        if isinstance(diagnostics.get(name), int)
    ]
    return Part(
        "diagnostics",
        "Sampling and its checks",
        {"gate": gate, "measures": measures, "counts": counts, "priors": diagnostics.get("priors", [])},
    )
