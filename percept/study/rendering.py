"""What the device renders with every passive hand, in time: directly and through the coupling."""

from __future__ import annotations

from percept.haptics import Coupling, Environment
from percept.haptics.rendering import can_render
from percept.results import Rendered
from percept.study.device import Setup
from percept.study.device_draws import device_stability

__all__ = ["study_rendering"]


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
    delay = setup.hold.delay
    found = can_render(setup.device, environment, setup.period, coupling=coupling, delay=delay)
    by_device = None
    if setup.draws is not None:
        by_device = device_stability(setup.draws, environment, coupling, setup.period, delay)
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
