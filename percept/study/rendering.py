"""What a device, or draws of it, renders with every passive hand, in time.

References are judged directly and through the coupling, and so are couplings that it does not have.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from percept.boundary.feels_real import share_error
from percept.haptics import Coupling, Device, Environment, Loop
from percept.haptics.aliases import alias_features
from percept.haptics.arrays import LARGEST
from percept.haptics.loop import search_grid
from percept.haptics.rendering import (
    can_render,
    needed_damping,
    rendered_region,
    rendering_load,
    rendering_margins,
)
from percept.results import DeviceStability, Rendered, RenderedEdge, RenderedWall, ZWidth
from percept.searches import secant_root
from percept.study.basics import Array
from percept.study.device import Setup

#: Devices with modes whose margins are searched for: each takes a search over frequencies. As many
#: independent ones tell a probability to a standard error of 0.03, and Sobol's points a better one.
_SEARCHED = 256
#: Share of the devices of a posterior that render what counts as likely.
_LIKELY = 0.95
#: A coupling that needs as many times what the environments need directly shows itself by a tenth
#: at most: it counts as rigid.
_RIGID = 10.0


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
        by_device=by_device,
        **vars(found),
    )


def z_width(
    loop: Loop, references: Mapping[str, Environment], draws: Device | None = None
) -> ZWidth:
    """Return the edge of what a device renders with every passive hand.

    Parameters
    ----------
    loop : Loop
        A table tells nothing where it begins late, or states no floor above its end. Delay and
        filter count; the kind of hold does not.
    references : mapping
        Environments to show beside the edge, by name.
    draws : Device, optional
        Of the device's posterior.

    Returns
    -------
    ZWidth
        Without an edge that is not known.
    """
    walls = [
        RenderedWall(name, float(wall.stiffness), float(wall.damping))
        for name, wall in references.items()
    ]
    likely = None
    if draws is not None:
        # The edge widens with the damping: what it reaches in 95 % of devices tells all.
        damping = float(np.quantile(draws.damping, 1.0 - _LIKELY))
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


def margins_of_draws(
    draws: Device, loop: Loop, environment: Environment | None, coupling: Coupling | None
) -> Array:
    """Return what each device dissipates over what is asked for, at its least.

    Parameters
    ----------
    draws : Device
        N devices, stacked.
    loop : Loop
        That they are in; its own device does not count.
    environment : Environment or None
        None for a rigid wall behind the coupling.
    coupling : Coupling or None
        None where the environment is rendered directly.

    Returns
    -------
    ndarray, shape (N,)
        Ratios: above 1 the device renders with every passive hand. All rigid devices are judged,
        exactly. Of devices with modes the first 256 are, each on frequencies of its own.
    """
    needed = needed_damping(loop, environment, coupling=coupling).damping
    damping = np.asarray(draws.damping)
    with np.errstate(divide="ignore"):
        margins = np.asarray(damping / np.float64(needed))
    if not draws.modes or np.isinf(needed):
        return margins
    margins = margins[:_SEARCHED]
    even = search_grid(dataclasses.replace(loop, device=Device(0.0, 0.0)))
    for index in range(margins.size):
        own = dataclasses.replace(loop, device=draws.select(index))
        omega = np.union1d(even, alias_features(own))
        load = rendering_load(own, omega, environment, coupling=coupling)
        # Modes only add to what the damping dissipates.
        margins[index] = max(margins[index], 1.0 / max(float(load.max()), np.finfo(float).tiny))
    return margins


def device_stability(
    draws: Device, loop: Loop, environment: Environment | None, coupling: Coupling | None
) -> DeviceStability:
    """Say how probably a device renders, given what is known of it.

    Parameters as in `margins_of_draws`.
    """
    margins = margins_of_draws(draws, loop, environment, coupling)
    stable = float(np.mean(margins > 1.0))
    return DeviceStability(
        probability=stable,
        error=share_error(stable, margins.size),
        draws=margins.size,
    )


class StableCouplings:
    """Couplings through which the device renders some environments with every passive hand.

    Of a posterior's devices with modes the damping alone counts: that is on the safe side.
    """

    def __init__(self, setup: Setup, environments: Sequence[str]) -> None:
        self.loop = setup.loop
        #: Number of devices from a posterior; None without one.
        self.devices = setup.draw_count
        self._environments = [setup.references[name] for name in environments]
        # What each device gives: its damping, N·s/m, or all that it dissipates.
        device = self.loop.device
        self._given = np.ones(1)
        if setup.draws is not None:
            self._given = np.sort(np.asarray(setup.draws.damping))
        elif isinstance(device, Device) and not device.modes:
            self._given = np.atleast_1d(device.damping)
        self._by_damping = isinstance(device, Device) and (
            setup.draws is not None or not device.modes
        )
        largest = max(self.at_nyquist(shown) for shown in setup.references.values())
        used = 0.0 if setup.coupling is None else self.at_nyquist(setup.coupling)
        #: N·s/m: couplings that ask for as much at Nyquist count as rigid.
        self.rigid_at_nyquist = max(_RIGID * largest, 2.0 * used)
        #: N/m: without damping they do from here on.
        self.rigid_stiffness = self.rigid_at_nyquist * 2.0 / self.loop.period

    def at_nyquist(self, shown: Environment | Coupling) -> float:
        """Return what a spring and a damper ask for at Nyquist, N·s/m."""
        return float(0.5 * shown.stiffness * self.loop.period + shown.damping)

    def probability(self, stiffness: Array, damping: Array) -> Array:
        """Return the probability that couplings (C,) are stable, (C,): 0 or 1 for one device."""
        asked = self._asked(stiffness, damping)
        return 1.0 - np.searchsorted(self._given, asked, side="right") / self._given.size

    def _asked(self, stiffness: Array, damping: Array) -> Array:
        """Return what couplings ask of a device, in terms of what each gives."""
        couplings = Coupling(stiffness, damping)
        asked = np.zeros(stiffness.shape)
        for shown in self._environments:
            if self._by_damping:
                own = needed_damping(self.loop, shown, coupling=couplings).damping
            else:
                own = 1.0 / rendering_margins(self.loop, shown, coupling=couplings)
            asked = np.maximum(asked, own)
        # A search for a root needs numbers.
        return np.minimum(asked, LARGEST)

    def largest_damping(self) -> float:
        """Return the largest b_c that is stable without a spring, N·s/m; 0 without any."""
        top = np.array([self.rigid_at_nyquist])
        return float(self._limit(lambda damping: self._asked(0.0 * damping, damping), top)[0])

    def limit(self, damping: Array) -> Array:
        """Return the largest stiffness beside each damping (B,) that may be stable, N/m, (B,).

        It ends where couplings count as rigid.
        """
        top = np.maximum(self.rigid_at_nyquist - damping, 0.0) * (2.0 / self.loop.period)
        return self._limit(self._asked, top, damping)

    def _limit(self, asked: Callable[..., Array], top: Array, *beside: Array) -> Array:
        """Return up to where each line, from zero to its top, asks for less than a device gives."""
        most = self._given[-1]

        def excess(which: NDArray[np.intp], value: Array) -> Array:
            return asked(value, *(one[which] for one in beside)) - most

        limit = secant_root(excess, 0.5 * top, 0.0 * top, top)
        every = np.arange(top.size)
        limit[excess(every, 0.0 * top) >= 0.0] = 0.0
        return np.where(excess(every, top) < 0.0, top, limit)
