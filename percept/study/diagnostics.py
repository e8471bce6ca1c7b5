"""What the numbers of a fit rest on."""

from __future__ import annotations

from typing import Any

from percept.inference.hierarchy.priors import MEANINGS
from percept.study.bayesian import Fit


def diagnostics(fit: Fit) -> dict[str, Any]:
    """Say how a fit was sampled, whether it passed, and under which priors."""
    run = fit.run
    ensembles, _, walkers, dimension = run.points.shape
    return {
        "gate": run.gate,
        "steps": run.steps,
        "ensembles": ensembles,
        "walkers": walkers,
        "dimension": dimension,
        "tolerance": run.settings.tolerance,
        "priors": [
            {"prior": name, "value": value, "meaning": MEANINGS[name]}
            for name, value in fit.prepared.model.priors.items()
        ],
    }
