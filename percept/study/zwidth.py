"""What a device renders stably, directly and through a coupling: its Z-width."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from percept.haptics import Device, Environment
from percept.haptics.limits import StableRegion
from percept.haptics.loop import hold_of
from percept.haptics.records import AnyDevice
from percept.haptics.rendering import coupled_region, direct_region
from percept.haptics.search import covers_range
from percept.results import RenderedEdge, RenderedWall, ZWidth
from percept.study.device import Loop, Setup
from percept.study.device_draws import DeviceDraws

__all__ = ["study_zwidth", "z_width"]

#: Share of the devices of a posterior that render what counts as likely.
_LIKELY = 0.95


def study_zwidth(setup: Setup | None) -> ZWidth | None:
    """Return what the device of a study renders stably; None without a device."""
    if setup is None:
        return None
    loop = Loop(hold_of(setup.hold), setup.velocity_filter)
    return z_width(setup.device, setup.period, loop, setup.references, setup.draws)


def z_width(
    device: AnyDevice,
    period: float,
    loop: Loop,
    references: Mapping[str, Environment],
    draws: DeviceDraws | None = None,
) -> ZWidth:
    """Return the edges of what a device renders stably.

    Parameters
    ----------
    device : Device or TabulatedDevice
        A table tells nothing of direct rendering: no damping of it holds above Nyquist.
    period : float
        Sampling period T, s.
    loop : Loop
        Its delay and its filter count both ways, the kind of hold with a coupling alone. From the
        second order of the filter on the edge of stable couplings is not known.
    references : mapping
        Environments to show beside the edges, by name.
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
    likely_direct = None
    likely_coupled = None
    if draws is not None:
        # Both edges widen with the damping: what it reaches in 95 % of devices tells all.
        damping = float(np.quantile(draws.stacked.damping, 1.0 - _LIKELY))
        likely = Device(0.0, damping)
        likely_direct = _direct_edge(likely, period, loop)
        if not draws.stacked.modes:
            likely_coupled = _coupled_edge(likely, period, loop)
    return ZWidth(
        direct=_direct_edge(device, period, loop),
        coupled=_coupled_edge(device, period, loop),
        references=tuple(walls),
        likely_direct=likely_direct,
        likely_coupled=likely_coupled,
    )


def _direct_edge(device: AnyDevice, period: float, loop: Loop) -> RenderedEdge | None:
    """Return what is passive when it is rendered directly; flexible modes are, like a hand."""
    if not isinstance(device, Device):
        return None
    damping = float(device.damping)
    velocity_filter = loop.velocity_filter
    region = direct_region(damping, period, delay=loop.hold.delay, velocity_filter=velocity_filter)
    return _edge(region)


def _coupled_edge(device: AnyDevice, period: float, loop: Loop) -> RenderedEdge | None:
    """Return the edge of stable couplings, where it is known."""
    velocity_filter = loop.velocity_filter
    known_filter = velocity_filter is None or velocity_filter.order == 1
    if not known_filter or not covers_range(device, period):
        return None
    return _edge(coupled_region(device, period, loop.hold, velocity_filter))


def _edge(region: StableRegion) -> RenderedEdge:
    """Return an edge without the corner at the origin."""
    stiffest = int(region.stiffness.argmax())
    return RenderedEdge(
        stiffness=region.stiffness[:-1],
        damping=region.damping[:-1],
        stiffest=float(region.stiffness[stiffest]),
        stiffest_damping=float(region.damping[stiffest]),
        most_damping=float(region.damping.max()),
    )
