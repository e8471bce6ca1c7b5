"""The device, coupling and environments of a document, as records of `percept.haptics`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from percept.haptics import Coupling, Device, Environment, Mode
from percept.report.select import family_of, first, matching

__all__ = ["Apparatus", "Box", "apparatus_of", "boxes_of"]

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Apparatus:
    """What a study was done with.

    Attributes
    ----------
    device : Device
    coupling : Coupling or None
    period : float
        s.
    hold : {"average", "true"}
    """

    device: Device
    coupling: Coupling | None
    period: float
    hold: str


@dataclass(frozen=True)
class Box:
    """An environment, and the limits of k and b that feel like it.

    Attributes
    ----------
    name : str
    environment : Environment
        The reference.
    stiffness, damping : tuple of float
        Lower and upper limit, N/m and N·s/m.
    method, family : str
        Where the limits come from.
    """

    name: str
    environment: Environment
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    method: str
    family: str


def apparatus_of(document: Document) -> Apparatus | None:
    """Return the scene's device and coupling, None where the device is absent or a measured table."""
    scene = document["provenance"]["scene"]
    table = scene.get("device")
    if not table or table.get("mass") is None:
        return None
    modes = tuple(
        Mode(mode["mass"], mode["stiffness"], mode.get("damping", 0.0)) for mode in table.get("modes", ())
    )
    coupling = scene.get("coupling")
    return Apparatus(
        Device(table["mass"], table["damping"], modes),
        Coupling(coupling["stiffness"], coupling["damping"]) if coupling else None,
        float(table["period"]),
        str(table.get("hold", "average")),
    )


def boxes_of(document: Document, kind: str) -> list[Box]:
    """Return the classical limits of a kind, of each environment that has both parameters."""
    rows = matching(document["intervals"], kind=kind, method="classical", joint="marginal")
    found = []
    for environment in dict.fromkeys(row["environment"] for row in rows):
        pair = [
            first(
                matching(rows, environment=environment, parameter=parameter),
                family=(family_of(document), "lognormal", "normal"),
            )
            for parameter in ("k", "b")
        ]
        k, b = pair
        if k is None or b is None or k["reference"] is None or b["reference"] is None:
            continue
        found.append(
            Box(
                environment,
                Environment(k["reference"], b["reference"]),
                (float(k["lower"]), float(k["upper"])),
                (float(b["lower"]), float(b["upper"])),
                k["method"],
                k["family"],
            )
        )
    return found
