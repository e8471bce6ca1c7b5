"""How verdicts move with other mass and damping of the device, which are seldom known well."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from percept.boundary.feels_real import judge, rough_probability
from percept.boundary.shares import Users
from percept.haptics import Device, can_render
from percept.results import ChangedVerdict, OtherDevices, Skipped
from percept.scene import Scene
from percept.study.device import Setup, map_frequencies, stiffness_span
from percept.study.verdicts import MapUsers

#: Draws of the users behind a probability: it is known to 0.02 by them, and differences better.
_DEVICE_DRAWS = 512
#: Of the scene's mass or damping, which are seldom known better.
_LESS = 0.5
_MORE = 1.5


def no_other_devices(setup: Setup, whose: MapUsers) -> Skipped | None:
    """Say why mass and damping are not varied; None where they are."""
    what = "verdicts with other mass and damping of the device"
    if not isinstance(setup.loop.device, Device):
        return Skipped(what, "a measured response has neither")
    if not whose.draws:
        return Skipped(what, "they need a joint law of stiffness and damping")
    return None


def other_devices(setup: Setup, whose: MapUsers, scene: Scene) -> OtherDevices | None:
    """Judge every environment again with other mass and damping of the device.

    None where `no_other_devices` says why.
    """
    if no_other_devices(setup, whose) is not None:
        return None
    setups = list(_setups(setup))
    within = scene.frequency.lower, scene.frequency.upper
    devices = [varied.loop.device for varied in setups if isinstance(varied.loop.device, Device)]
    central = scene.verdict.central
    decision = scene.inference.decision
    verdicts = []
    for environment, population in whose.draws.items():
        some = population.select(slice(0, _DEVICE_DRAWS))
        for coupled in (False, True) if setup.coupling is not None else (False,):
            probabilities = tuple(
                _probability(varied, environment, some, central, within, coupled=coupled)
                for varied in setups
            )
            verdict = ChangedVerdict(
                environment=environment,
                coupled=coupled,
                probability=probabilities,
                outcome=tuple(judge(one, decision) for one in probabilities),
                rendered=tuple(_renders(varied, environment, coupled=coupled) for varied in setups),
            )
            verdicts.append(verdict)
    return OtherDevices(
        mass=tuple(float(device.mass) for device in devices),
        damping=tuple(float(device.damping) for device in devices),
        coupled=setup.coupling is not None,
        verdicts=tuple(verdicts),
        method=whose.method,
        draws=min(_DEVICE_DRAWS, *(population.size for population in whose.draws.values())),
    )


def _setups(setup: Setup) -> Iterator[Setup]:
    """Yield the scene's own device, then less and more mass, then less and more damping."""
    device = setup.loop.device
    assert isinstance(device, Device)
    devices = [device]
    for factor in (_LESS, _MORE):
        devices.append(dataclasses.replace(device, mass=factor * device.mass))
    for factor in (_LESS, _MORE):
        devices.append(dataclasses.replace(device, damping=factor * device.damping))
    for other in devices:
        yield setup.with_device(other)


def _renders(setup: Setup, environment: str, *, coupled: bool) -> bool:
    """Whether the device renders an environment with every passive hand, in time."""
    shown = setup.display(environment, coupled=coupled)
    return can_render(setup.loop, shown.environment, coupling=shown.coupling).verdict == "can"


def _probability(
    setup: Setup,
    environment: str,
    users: Users,
    central: float,
    within: tuple[float, float],
    *,
    coupled: bool,
) -> float:
    """Judge one environment on one device."""
    span = stiffness_span(setup, environment, users, central)
    omega = map_frequencies(setup, environment, span, within)
    display = setup.display(environment, coupled=coupled)
    return rough_probability(display, users, omega, central=central)
