"""What a device renders with every passive hand, in time: each reference, and its Z-width."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from percept.haptics import Coupling, Device, Environment, Loop
from percept.haptics.rendering import can_render, rendered_region
from percept.results import Rendered, RenderedEdge, RenderedWall, ZWidth
from percept.study.device import Setup
from percept.study.device_draws import DeviceDraws, device_stability

#: Share of the devices of a posterior that render what counts as likely.
_LIKELY = 0.95


def study_rendering(setup: Setup) -> tuple[Rendered, ...]:
    """Judge every reference, directly and through the coupling, and a rigid wall behind it."""
    rows = [_rendered(setup, name, coupled=False) for name in setup.references]
    if setup.coupling is not None:
        rows += [_rendered(setup, name, coupled=True) for name in (*setup.references, None)]
    return tuple(rows)


def _rendered(setup: Setup, name: str | None, *, coupled: bool) -> Rendered:
    """Judge one reference, or a rigid wall (None)."""
    environment: Environment | None = None
    coupling: Coupling | None = setup.coupling
    if name is not None:
        display = setup.display(name, coupled=coupled)
        environment = display.environment
        coupling = display.coupling
    found = can_render(setup.loop, environment, coupling=coupling)
    by_device = None
    if setup.draws is not None:
        by_device = device_stability(setup.draws, setup.loop, environment, coupling)
    return Rendered(
        environment=name,
        coupled=coupled,
        verdict=found.verdict,
        reason=found.reason,
        needed_damping=found.needed_damping,
        margin=found.margin,
        binding_omega=found.binding_omega,
        by_device=by_device,
    )


def study_zwidth(setup: Setup | None) -> ZWidth | None:
    """Return what the device of a study renders; None without a device."""
    if setup is None:
        return None
    return z_width(setup.loop, setup.references, setup.draws)


def z_width(
    loop: Loop, references: Mapping[str, Environment], draws: DeviceDraws | None = None
) -> ZWidth:
    """Return the edge of what a device renders with every passive hand.

    Parameters
    ----------
    loop : Loop
        A table tells nothing where it begins late, or states no floor above its end. Delay and
        filter count; the kind of hold does not.
    references : mapping
        Environments to show beside the edge, by name.
    draws : DeviceDraws, optional
        Of the device's posterior.

    Returns
    -------
    ZWidth
        Without an edge that is not known.
    """
    walls = []
    for name, wall in references.items():
        walls.append(RenderedWall(name, float(wall.stiffness), float(wall.damping)))
    likely = None
    if draws is not None:
        # The edge widens with the damping: what it reaches in 95 % of devices tells all.
        damping = float(np.quantile(draws.stacked.damping, 1.0 - _LIKELY))
        likely = _edge(dataclasses.replace(loop, device=Device(0.0, damping)))
    # Of nothing to render only a table can leave something open.
    known = can_render(loop, Environment(0.0, 0.0)).verdict == "can"
    return ZWidth(
        edge=_edge(loop) if known else None,
        references=tuple(walls),
        likely=likely,
    )


def _edge(loop: Loop) -> RenderedEdge:
    region = rendered_region(loop)
    stiffest = int(region.stiffness.argmax())
    return RenderedEdge(
        stiffness=region.stiffness,
        damping=region.damping,
        stiffest=float(region.stiffness[stiffest]),
        stiffest_damping=float(region.damping[stiffest]),
        most_damping=float(region.damping.max()),
    )
