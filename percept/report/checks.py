"""Checks of the hierarchical model as the document holds them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from percept.report.plain import plain

if TYPE_CHECKING:
    from percept.study import Study


def checks_of(study: Study) -> dict[str, Any] | None:
    """Collect the model checks that the scene asks for."""
    asked = study.scene.checks
    if asked is None or study.checks is None:
        return None
    found: dict[str, Any] = plain(study.checks)
    # A row per subject, environment and parameter would be most of the document.
    found["loo"]["cells"] = [row for row in found["loo"]["cells"] if row["outlier"]]
    compared = asked.compare and len(study.environments) > 1
    found["models"] = plain(study.model_choice) if compared else None
    return found
