"""The sampler's diagnostics and the gate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]

_MEASURES = (
    ("rhat", "Rank R̂ across ensembles, largest", "below 1.01"),
    ("autocorrelation_time", "Autocorrelation time, largest (steps)", "finite"),
    ("times_run", "Length of each kept run (autocorrelation times)", "10 or more"),
    ("effective_draws", "Effective draws, smallest", ""),
    ("acceptance", "Share of proposals accepted", ""),
    ("worst_error", "Monte Carlo error of the worst endpoint (half-widths)", "within the tolerance"),
)


def build(document: Mapping[str, Any]) -> Part | None:
    """Return the gate's verdict and the measures behind it.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part or None
    """
    diagnostics = document["diagnostics"]
    if not diagnostics:
        return None
    gate = diagnostics["gate"]
    measures = [
        {"label": label, "asked": asked, "place": f"/diagnostics/gate/{name}"}
        for name, label, asked in _MEASURES
        if isinstance(gate.get(name), (int, float))
    ]
    return Part("diagnostics", "Sampling and its checks", {"gate": gate, "measures": measures})
