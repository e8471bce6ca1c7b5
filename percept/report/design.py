"""Which couplings are stable and keep each environment inside its boundary: the map for a designer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from percept.haptics import Coupling, CouplingDesign, Device, QualifyingRegion, stable_region
from percept.report.plain import plain

if TYPE_CHECKING:
    from percept.study import Study


def design_of(study: Study) -> dict[str, Any] | None:
    """Unpack the couplings that qualify, by method, environment and for all environments."""
    found = study.coupling_design
    if not found:
        return None
    (frequencies,) = {design.frequencies for design in found.values()}
    return {
        "kind": "user",
        "family": study.scene.inference.family,
        "frequencies": frequencies,
        "stable": _edge(study),
        "maps": [{"method": method, **_map(design, study.environments)} for method, design in found.items()],
    }


def _map(design: CouplingDesign, environments: tuple[str, ...]) -> dict[str, Any]:
    regions = [*zip(environments, design.each, strict=True), (None, design.common)]
    return {
        "damping": plain(design.common.damping),
        "environments": [{"name": name, **_region(region)} for name, region in regions],
    }


def _edge(study: Study) -> dict[str, Any] | None:
    device, table = study.device, study.scene.device
    if table is None or not isinstance(device, Device) or device.modes:
        return None
    region = stable_region(float(device.damping), table.period, hold=table.hold, points=65)
    return {"stiffness": plain(region.stiffness), "damping": plain(region.damping)}


def _region(region: QualifyingRegion) -> dict[str, Any]:
    return {
        "intervals": [plain(part) for part in region.intervals],
        "largest": _coupling(region.largest),
        "softest": _coupling(region.softest),
    }


def _coupling(coupling: Coupling | None) -> dict[str, Any] | None:
    if coupling is None:
        return None
    return {"stiffness": float(coupling.stiffness), "damping": float(coupling.damping)}
