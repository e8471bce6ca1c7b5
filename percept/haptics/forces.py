"""The force that a sampled loop makes of a position: H of environments, couplings and both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from percept.haptics.arrays import FloatArray, IntArray, Scalars, ratio
from percept.haptics.impedance import filter_response
from percept.haptics.loop import VelocityFilter, Warp
from percept.haptics.records import Coupling, Environment, Mode

__all__ = ["Force", "Joined", "force_of"]

# Couplings whose resonances with an environment's mass are looked for.
_RESONANCES = 16


class Force(NamedTuple):
    """H at each ω, N/m: real + j·sin h·slope, so that nothing cancels next to DC."""

    real: FloatArray
    slope: FloatArray


def _element(
    grid: Warp, k: Scalars, b: Scalars, m: Scalars, velocity_filter: VelocityFilter | None
) -> Force:
    """Return k + b·F·δ + m·δ²."""
    response = np.ones(grid.half.shape, dtype=np.complex128)
    if velocity_filter is not None:
        response = filter_response(grid, velocity_filter)
    rate = 2 / grid.period
    damper = rate * grid.sin * (grid.sin * response.real - grid.cos * response.imag)
    damper_slope = rate * (grid.sin * response.imag + grid.cos * response.real)
    inertia = (rate * grid.sin) ** 2
    mass = inertia * (grid.sin - grid.cos) * (grid.sin + grid.cos)
    mass_slope = 2 * rate**2 * grid.sin**2 * grid.cos
    real = k + np.multiply(b, damper) + np.multiply(m, mass)
    return Force(real, np.multiply(b, damper_slope) + np.multiply(m, mass_slope))


def _in_series(grid: Warp, first: Force, second: Force) -> Force:
    """Return H₁H₂/(H₁ + H₂) as a₂²·H₁ + a₁²·H₂, aᵢ = abs(Hᵢ)/abs(H₁ + H₂)."""
    total = np.hypot(first.real + second.real, grid.sin * (first.slope + second.slope))
    first_size = np.hypot(first.real, grid.sin * first.slope)
    second_size = np.hypot(second.real, grid.sin * second.slope)
    of_first = ratio(second_size, total, empty=0.0) ** 2
    of_second = ratio(first_size, total, empty=0.0) ** 2
    return Force(
        real=of_first * first.real + of_second * second.real,
        slope=of_first * first.slope + of_second * second.slope,
    )


def force_of(grid: Warp, environment: Environment | None, coupling: Coupling | None) -> Force:
    """Return H of an environment, of a coupling with a rigid wall behind it, or of both.

    The loop filters the velocity of what joins the device.
    """
    velocity_filter = grid.loop.velocity_filter
    own_filter = velocity_filter if coupling is None else None
    shown = None
    if environment is not None:
        k, b, m = environment.stiffness, environment.damping, environment.mass
        shown = _element(grid, k, b, m, own_filter)
    if coupling is None:
        assert shown is not None
        return shown
    joined = _element(grid, coupling.stiffness, coupling.damping, 0.0, velocity_filter)
    return joined if shown is None else _in_series(grid, joined, shown)


@dataclass(frozen=True)
class Joined:
    """What joins a device: n environments, n couplings, or n of both; parameters of shape (n,)."""

    environment: Environment | None
    coupling: Coupling | None
    shape: tuple[int, ...]  # That n stands for

    @classmethod
    def of(cls, environment: Environment | None, coupling: Coupling | None) -> Joined:
        """Broadcast all parameters and take them flat."""
        given: list[Scalars] = []
        for record in (environment, coupling):
            if record is not None:
                given += record.parameters().values()
        shape = np.broadcast_shapes(*(np.shape(value) for value in given))

        def flat(record: Environment | Coupling) -> dict[str, FloatArray]:
            parameters = record.parameters().items()
            return {name: np.broadcast_to(value, shape).ravel() for name, value in parameters}

        return cls(
            environment and replace(environment, **flat(environment)),
            coupling and replace(coupling, **flat(coupling)),
            shape,
        )

    @property
    def size(self) -> int:
        """Number n."""
        return int(np.prod(self.shape))

    def select(self, which: IntArray) -> Joined:
        """Return some of them."""
        environment = self.environment and self.environment.select(which)
        coupling = self.coupling and self.coupling.select(which)
        return Joined(environment, coupling, which.shape)

    def resonances(self) -> tuple[Mode, ...]:
        """Return modes that resonate where H does: an environment's mass on all springs."""
        if self.environment is None or not np.any(self.environment.mass):
            return ()
        stiffness = np.asarray(self.environment.stiffness)
        damping = np.asarray(self.environment.damping)
        if self.coupling is not None:
            stiffness = stiffness + self.coupling.stiffness
            damping = damping + self.coupling.damping
        order = np.argsort(stiffness)
        some = order[np.linspace(0, order.size - 1, min(_RESONANCES, order.size)).astype(int)]
        masses = np.asarray(self.environment.mass)
        return tuple(Mode(masses[one], stiffness[one], damping[one]) for one in some)
