"""What a sampled loop can render with every passive hand: stability in time.

The computer samples the position, works out a force H from it by backward differences
δ = (1 − z⁻¹)/T, and holds the force for a sample, later by a delay:

    directly H_e = k + b·δ + m·δ²      a rigid wall through a coupling H_c = k_c + b_c·δ
    through a coupling H = H_c·H_e/(H_c + H_e)

A velocity filter F makes a damper b·F·δ. The motion dies out with every passive hand if and only
if the poles of H lie inside the unit circle and no ω asks for more than the device dissipates
(Colgate and Schenkel). Of a rigid device ω asks for b_d > Re W, with h = ωT/2 and

    W = T·(1 − e^{−2jh})·H/(4 sin² h)

A whole delay of n samples multiplies W by e^{−2jnh}. A further fraction f turns each alias of ω by
another angle. Their discs then add up to the condition of `_load`. Tustin's method is left out: its
damper has a pole at z = −1, so no damping is enough for every hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from percept.haptics.aliases import Aliases, alias_features, aliases
from percept.haptics.arrays import BoolArray, FloatArray, IntArray, Scalars, ratio, stored
from percept.haptics.impedance import filter_response
from percept.haptics.loop import Loop, VelocityFilter, Warp, search_grid
from percept.haptics.records import (
    Coupling,
    Device,
    Environment,
    Mode,
    NeededDamping,
    TabulatedDevice,
    joint_shape,
    refuse_arrays,
)
from percept.html import NotebookRecord
from percept.searches import lowest

# Couplings, evenly from the softest to the stiffest, whose resonances with an environment's mass
# are looked for.
_RESONANCES = 16
# Of 1 N·s/m: the load on it is the damping needed.
_UNIT_DAMPER = Device(0.0, 1.0)
_NO_DEVICE = Device(0.0, 0.0)
# How near to 1 a margin counts as short of it.
_ROUNDING = 1e-12
# Rows of a region's edge: enough to show its corners.
_EDGE_POINTS = 129
# A table may begin at this fraction of Nyquist: below it the first row holds.
_LATEST_START = 1e-3
# rad, by which H_c + H_e must turn back from DC to Nyquist. A pole outside the circle makes it half
# a turn; without a spring it is a quarter though none lies there. The limit stands between.
_TURNED = 0.75 * np.pi


class Force(NamedTuple):
    """H at each ω, N/m: real + j·sin h·slope, so that nothing cancels next to DC."""

    real: FloatArray
    slope: FloatArray

    def size(self, grid: Warp) -> FloatArray:
        """Return abs(H), N/m."""
        return np.hypot(self.real, grid.sin * self.slope)


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
    total = Force(first.real + second.real, first.slope + second.slope).size(grid)
    first_weight = ratio(second.size(grid), total, empty=0.0) ** 2
    second_weight = ratio(first.size(grid), total, empty=0.0) ** 2
    return Force(
        real=first_weight * first.real + second_weight * second.real,
        slope=first_weight * first.slope + second_weight * second.slope,
    )


def force_of(grid: Warp, environment: Environment | None, coupling: Coupling | None) -> Force:
    """Return H of an environment, of a coupling with a rigid wall behind it, or of both.

    The loop filters the velocity of what joins the device.
    """
    velocity_filter = grid.loop.velocity_filter
    environment_filter = velocity_filter if coupling is None else None
    shown = None
    if environment is not None:
        k, b, m = environment.stiffness, environment.damping, environment.mass
        shown = _element(grid, k, b, m, environment_filter)
    if coupling is None:
        assert shown is not None
        return shown
    joined = _element(grid, coupling.stiffness, coupling.damping, 0.0, velocity_filter)
    return joined if shown is None else _in_series(grid, joined, shown)


def resonances(environment: Environment | None, coupling: Coupling | None) -> tuple[Mode, ...]:
    """Return modes that resonate where H does: an environment's mass on all springs."""
    if environment is None or not np.any(environment.mass):
        return ()
    stiffness = environment.stiffness
    damping = environment.damping
    if coupling is not None:
        stiffness = stiffness + coupling.stiffness
        damping = damping + coupling.damping
    modes = np.stack(np.broadcast_arrays(environment.mass, stiffness, damping), axis=-1)
    modes = modes.reshape(-1, 3)
    order = np.argsort(modes[:, 1])
    some = order[np.linspace(0, order.size - 1, min(_RESONANCES, order.size)).astype(int)]
    return tuple(Mode(*mode) for mode in modes[some])


@dataclass(frozen=True)
class Rendering(NotebookRecord):
    """Whether a device renders an environment with every passive hand, in time."""

    verdict: Literal["can", "cannot", "undecided"]
    reason: str  # What decides, in one sentence
    needed_damping: float  # That a rigid device needs, N·s/m; inf where none suffices
    margin: float  # What the device dissipates over what is asked for, at its least
    binding_omega: float  # Where the margin is least, rad/s


def _load(grid: Warp, force: Force, dissipated: Aliases) -> FloatArray:
    """Return what each ω asks for, as a fraction of what the device dissipates there.

    Without a fraction of delay this is Re W/b_eff. With one it is the largest μ at which the circle
    of centre μ·C and radius μ·abs(ρ) holds 1/W: C and ρ are half the sums over the aliases.
    """
    fraction, samples = np.modf(grid.loop.delay)
    real = _real_part(grid, force, samples)
    mean = real
    if fraction:
        mean = (1 - fraction) * real + fraction * _real_part(grid, force, samples + 1)
    # W·sin h is finite at DC.
    angle = (2 * samples + 1) * grid.half
    turned = np.cos(angle) * force.real + np.sin(angle) * grid.sin * force.slope
    w_sin = grid.sin * real + 1j * (grid.period / 2) * turned
    constant, turn, rest, late_rest = dissipated
    load = mean * constant + grid.sin * (w_sin * late_rest).real
    if not fraction:
        return np.maximum(load, 0.0)
    spread = 4 * fraction * (1 - fraction) * np.square(constant)
    spread = spread + 2 * constant * (rest - (turn * np.conj(late_rest)).real)
    spread = spread + grid.sin**2 * (rest**2 - np.abs(late_rest) ** 2)
    root = np.sqrt(load**2 + np.abs(w_sin) ** 2 * np.maximum(spread, 0.0))
    return np.asarray((load + root) / 2)


def _real_part(grid: Warp, force: Force, samples: float) -> FloatArray:
    """Return Re W after a delay of whole samples, N·s/m."""
    angle = (2 * samples + 1) * grid.half
    per_sin = ratio(np.sin(angle), grid.sin, empty=2 * samples + 1)
    return np.asarray((grid.period / 2) * (per_sin * force.real - np.cos(angle) * force.slope))


def rendering_load(
    loop: Loop,
    omega: ArrayLike,
    environment: Environment | None,
    *,
    coupling: Coupling | None = None,
) -> FloatArray:
    """Return what each ω asks of a device, as a fraction of what it dissipates there.

    Parameters
    ----------
    loop : Loop
        Of single numbers; the damping of a rigid device may be an array. Its hold does not count:
        a force is held for a sample.
    omega : array_like
        rad/s, up to π/T in magnitude.
    environment : Environment or None
        None for a rigid wall behind the coupling. Its parameters broadcast against ω.
    coupling : Coupling, optional
        None where the environment is rendered directly. Its parameters broadcast against ω.

    Returns
    -------
    ndarray
        Dimensionless; below 1 at every ω means that no passive hand makes the motion grow.

    Raises
    ------
    UsageError
        ω above Nyquist.
    """
    grid = loop.at(omega)
    return _load(grid, force_of(grid, environment, coupling), aliases(grid))


def needed_damping(
    loop: Loop, environment: Environment | None, *, coupling: Coupling | None = None
) -> NeededDamping:
    """Return the damping above which a rigid device renders with every passive hand.

    Parameters as in `rendering_load`; the shapes of environment and coupling broadcast.
    The device of the loop does not count.

    Returns
    -------
    NeededDamping
        Of the broadcast shape; inf where a pole of H lies outside the unit circle.

    Notes
    -----
    Without delay and filter it is, with A = k·T/2 + b + 2m/T, A_e directly, A_c with a rigid wall
    and, for an environment without mass, A_c·A_e/(A_c + A_e) through the coupling; all at Nyquist.
    Otherwise it is searched over ω.
    """
    heavy = environment is not None and coupling is not None and np.any(environment.mass)
    if not (loop.delay or loop.velocity_filter or heavy):
        damping = _damping_at_nyquist(loop.period, environment, coupling)
        return NeededDamping(stored(damping), stored(np.full(damping.shape, loop.nyquist)))
    damping, omega = _largest_load(replace(loop, device=_UNIT_DAMPER), environment, coupling)
    return NeededDamping(stored(damping), stored(omega))


def _damping_at_nyquist(
    period: float, environment: Environment | None, coupling: Coupling | None
) -> FloatArray:
    """Return what a rigid device needs without delay and filter, N·s/m."""
    half = period / 2
    parts = []
    if environment is not None:
        elastic = np.multiply(environment.stiffness, half)
        parts.append(elastic + environment.damping + np.divide(environment.mass, half))
    if coupling is not None:
        parts.append(np.multiply(coupling.stiffness, half) + coupling.damping)
    if len(parts) == 1:
        return np.asarray(parts[0])
    smaller = np.minimum(*parts)
    larger = np.maximum(*parts)
    # Divided first: a product may leave the range of a double.
    return np.asarray(smaller * ratio(larger, smaller + larger, empty=0.0))


def _largest_load(
    loop: Loop, environment: Environment | None, coupling: Coupling | None
) -> tuple[FloatArray, FloatArray]:
    """Search the largest load over ω, and where it is, rad/s; both of the broadcast shape.

    It is inf where a pole of H lies outside the circle. On a device of 1 N·s/m it is the damping
    needed.
    """
    shape = joint_shape(environment, coupling)
    environments = environment and environment.flat(shape)
    couplings = coupling and coupling.flat(shape)
    of_force = search_grid(replace(loop, device=_NO_DEVICE), resonances(environment, coupling))
    candidates = np.unique(np.concatenate([of_force, alias_features(loop)]))

    def negative_load(omega: FloatArray, which: IntArray) -> FloatArray:
        rendered = environments and environments.select(which)
        return -rendering_load(
            loop, omega, rendered, coupling=couplings and couplings.select(which)
        )

    least = lowest(negative_load, candidates, int(np.prod(shape)))
    outside = _has_pole_outside(loop, candidates, environments, couplings)
    load = np.where(outside, np.inf, -least.value)
    return load.reshape(shape), least.x.reshape(shape)


def _has_pole_outside(
    loop: Loop, omega: FloatArray, environment: Environment | None, coupling: Coupling | None
) -> BoolArray:
    """Say which H has a pole outside the unit circle, (n,), by the argument principle.

    The poles are the zeros of H_c + H_e. Without a filter they all lie inside: a backward
    difference maps the left half plane there.
    """
    if environment is None or coupling is None or loop.velocity_filter is None:
        return np.zeros(1, dtype=bool)
    total = np.zeros((omega.size, 1), dtype=np.complex128)
    unfiltered = replace(loop, velocity_filter=None)
    for its_loop, behind, at_device in ((unfiltered, environment, None), (loop, None, coupling)):
        grid = its_loop.at(omega[:, None])
        force = force_of(grid, behind, at_device)
        total = total + force.real + 1j * grid.sin * force.slope
    steps = np.angle(total[1:] * np.conj(total[:-1]))
    return np.asarray(steps.sum(axis=0) < -_TURNED)


def rendering_margins(
    loop: Loop, environment: Environment | None, *, coupling: Coupling | None = None
) -> FloatArray:
    """Return what a device dissipates over what is asked for, at the ω where that is least.

    Parameters as in `rendering_load`; the shapes of environment and coupling broadcast.

    Returns
    -------
    ndarray
        Of the broadcast shape; above 1 the device renders with every passive hand.
    """
    if loop.rigid is not None:
        need = needed_damping(loop, environment, coupling=coupling)
        return ratio(loop.rigid.damping, need.damping, empty=np.inf)
    load, _ = _largest_load(loop, environment, coupling)
    return ratio(1.0, load, empty=np.inf)


def can_render(
    loop: Loop, environment: Environment | None, *, coupling: Coupling | None = None
) -> Rendering:
    """Judge whether a device renders an environment with every passive hand, in time.

    Parameters as in `rendering_load`, for one device, one environment and one coupling.

    Returns
    -------
    Rendering
        "undecided" where a table begins too late, or its floor would decide and is not known.

    Raises
    ------
    UsageError
        Arrays as parameters.
    """
    device = loop.device
    refuse_arrays(device, coupling, environment)
    need = needed_damping(loop, environment, coupling=coupling)
    if loop.rigid is not None:
        margin = float(ratio(loop.rigid.damping, need.damping, empty=np.inf))
        binding = float(need.omega)
    else:
        load, omega = _largest_load(loop, environment, coupling)
        margin = float(ratio(1.0, load, empty=np.inf))
        binding = float(omega)
    verdict: Literal["can", "cannot", "undecided"] = "can"
    reason = f"The smallest margin is {margin:.6g}, at {binding:.6g} rad/s."
    if np.isinf(need.damping):
        verdict = "cannot"
        reason = "The velocity filter makes the virtual environment itself unstable."
    elif margin <= 1 + _ROUNDING:
        verdict = "cannot"
    elif isinstance(device, TabulatedDevice):
        if device.omega[0] * loop.period > _LATEST_START * np.pi:
            verdict = "undecided"
            reason = f"Below {device.omega[0]:.6g} rad/s the device's table says nothing."
        elif device.floor is None:
            verdict = "undecided"
            reason = (
                f"Above {device.omega[-1]:.6g} rad/s the device's table says nothing, and it states"
                " no floor of Re Z_d there."
            )
    return Rendering(verdict, reason, float(need.damping), margin, binding)


class RenderedRegion(NamedTuple):
    """The edge of what a device renders directly, and of couplings with a rigid wall behind."""

    stiffness: FloatArray  # N/m, (n,), falling
    damping: FloatArray  # N·s/m, rising from zero


def rendered_region(loop: Loop) -> RenderedRegion:
    """Return the edge of all (k, b) that a device renders with every passive hand.

    Parameters
    ----------
    loop : Loop
        Of single numbers. A table without a floor is taken to dissipate all above its end.

    Returns
    -------
    RenderedRegion
        From b = 0 to k = 0. What lies nearer to the origin on the same ray is rendered as well:
        the load is proportional to the force.
    """
    damping = np.linspace(0.0, 1.0, _EDGE_POINTS)
    wall = Environment((1 - damping) * 2 / loop.period, damping)
    reach = rendering_margins(loop, wall)
    return RenderedRegion(reach * wall.stiffness, reach * wall.damping)
