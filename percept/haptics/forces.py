"""The force that a sampled loop makes of a position: H of environments, couplings and both."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from percept.haptics.arrays import ComplexArray, FloatArray, IntArray, Scalars, ratio
from percept.haptics.axis import Warp
from percept.haptics.records import Coupling, Environment, Mode
from percept.haptics.velocity import VelocityFilter, filter_response

__all__ = ["Force", "Shown", "flat_parameters", "force_of"]

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
    response: ComplexArray = np.ones(grid.half.shape, dtype=np.complex128)
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
    """Return H of an environment, of a coupling with a rigid wall behind it, or of both."""
    shown = None
    if environment is not None:
        k, b, m = environment.stiffness, environment.damping, environment.mass
        shown = _element(grid, k, b, m, environment.velocity_filter)
    if coupling is None:
        assert shown is not None
        return shown
    k_c, b_c = coupling.stiffness, coupling.damping
    joined = _element(grid, k_c, b_c, 0.0, coupling.velocity_filter)
    return joined if shown is None else _in_series(grid, joined, shown)


class Shown(NamedTuple):
    """n environments, n couplings, or n of both; parameters of shape (n,)."""

    environment: Environment | None
    coupling: Coupling | None
    size: int

    def select(self, which: IntArray) -> Shown:
        """Return some of them."""
        environment = self.environment
        if environment is not None:
            environment = replace(
                environment,
                stiffness=np.asarray(environment.stiffness)[which],
                damping=np.asarray(environment.damping)[which],
                mass=np.asarray(environment.mass)[which],
            )
        coupling = self.coupling
        if coupling is not None:
            stiffness = np.asarray(coupling.stiffness)[which]
            coupling = replace(
                coupling, stiffness=stiffness, damping=np.asarray(coupling.damping)[which]
            )
        return Shown(environment, coupling, which.size)

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


def flat_parameters(
    environment: Environment | None, coupling: Coupling | None
) -> tuple[Shown, tuple[int, ...]]:
    """Broadcast all parameters and return them flat, with their shape."""
    given: list[Scalars] = []
    if environment is not None:
        given += [environment.stiffness, environment.damping, environment.mass]
    if coupling is not None:
        given += [coupling.stiffness, coupling.damping]
    arrays = np.broadcast_arrays(*given)
    flat = [array.ravel() for array in arrays]
    if environment is not None:
        k, b, m = flat[:3]
        environment = replace(environment, stiffness=k, damping=b, mass=m)
    if coupling is not None:
        coupling = replace(coupling, stiffness=flat[-2], damping=flat[-1])
    return Shown(environment, coupling, flat[0].size), arrays[0].shape
