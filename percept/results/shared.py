"""Curves that every boundary of an environment shares: report.json holds them once."""

from __future__ import annotations

from typing import Any

from percept.results.plain import JsonObject

#: They depend on the environment, device and coupling, and on no interval.
_SHARED = ("omega", "reference", "coupled")


def share_curves(boundaries: list[JsonObject]) -> dict[str, JsonObject]:
    """Take the shared curves out of plain boundaries, and return them by environment.

    A boundary whose curves differ from the first one's of its environment keeps its own.
    """
    shared: dict[str, JsonObject] = {}
    for boundary in boundaries:
        curves = {name: boundary[name] for name in _SHARED}
        if shared.setdefault(boundary["environment"], curves) == curves:
            for name in _SHARED:
                del boundary[name]
    return shared


def with_shared_curves(boundaries: Any, shared: Any) -> Any:
    """Return plain boundaries with the curves of their environments; undo `share_curves`.

    What has another shape is returned as it is: the schema reports it.
    """
    if not isinstance(boundaries, list) or not isinstance(shared, dict):
        return boundaries
    complete = []
    for boundary in boundaries:
        if isinstance(boundary, dict):
            curves = shared.get(boundary.get("environment"))
            boundary = {**(curves or {}), **boundary}
        complete.append(boundary)
    return complete
