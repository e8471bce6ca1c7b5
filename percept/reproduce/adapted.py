"""The paper's future work: couplings that are stable and keep each environment real for the next user."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from percept.haptics import Device, magnitude_envelope
from percept.haptics.design import CouplingDesign, EnvironmentBoundary, design_couplings
from percept.reproduce.published import Array, Published

__all__ = ["Adapted", "adapted_couplings", "environments_inside", "next_user_boundaries"]

_POINTS = 31  # Of ω over the perceivable range, for each of many devices


@dataclass(frozen=True, eq=False)
class Adapted:
    """The couplings that suit each environment on one device, and the one for all, if there is one."""

    device: Device
    design: CouplingDesign  # In the order of Table 1
    static: tuple[bool, ...]  # By environment, whether the paper's tuned coupling is among them


def next_user_boundaries(published: Published) -> tuple[EnvironmentBoundary, ...]:
    """Return the limits of each environment: prediction intervals of the next user."""
    boundaries = []
    for wall, (k, b) in zip(published.walls, published.next_user, strict=True):
        boundaries.append(EnvironmentBoundary(wall.environment, k, b))
    return tuple(boundaries)


def adapted_couplings(published: Published) -> Adapted:
    """Return the couplings that qualify on the device Fig. 4 implies: stable, and inside at every ω."""
    device = Device(published.device.mass, published.needed())
    boundaries = next_user_boundaries(published)
    span = published.span
    period = published.period
    design = design_couplings(device, boundaries, span, period)
    line = np.array([float(published.tuned.damping)])
    of_tuned_damping = design_couplings(device, boundaries, span, period, damping=line)
    static = []
    for region in of_tuned_damping.each:
        ranges = region.intervals[0].tolist()
        static.append(any(low <= published.tuned.stiffness <= high for low, high in ranges))
    return Adapted(device, design, tuple(static))


def environments_inside(published: Published, mass: Array, damping: Array) -> NDArray[np.int64]:
    """Count the environments that feel real through the tuned coupling, by device.

    Parameters
    ----------
    published : Published
        The paper.
    mass, damping : ndarray
        Of the devices, kg and N·s/m; their shapes broadcast.

    Returns
    -------
    ndarray of int
        Of the broadcast shape: references inside the next user's envelope at every perceivable ω.
    """
    device = Device(mass[..., None], damping[..., None])
    omega = published.omega(_POINTS)
    count = np.zeros(np.broadcast_shapes(mass.shape, damping.shape), dtype=np.int64)
    for wall, (k, b) in zip(published.walls, published.next_user, strict=True):
        lower, upper = magnitude_envelope(omega, device, k, b, published.period)
        felt = published.felt(omega, wall.environment, device=device, coupling=published.tuned)
        count += ((lower <= felt) & (felt <= upper)).all(axis=-1)
    return count
