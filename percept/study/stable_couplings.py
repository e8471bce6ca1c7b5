"""Which couplings are stable, with the scene's device or with how many of its posterior."""

from __future__ import annotations

import dataclasses

import numpy as np

from percept.boundary.feels_real import share_error
from percept.haptics import Coupling, absolute_stability
from percept.haptics.limits import largest_coupling_damping, stable_stiffness
from percept.haptics.records import AnyDevice
from percept.study.basics import Array
from percept.study.device import Setup

__all__ = ["Chance", "StableCouplings", "is_stable"]

#: Devices of a posterior behind a map: a probability of 0.95 is known to 0.03, or better by an
#: even net.
_DEVICES = 64
#: Dampings at which the devices' limits are worked out; between them limits are interpolated.
_KNOTS = 65


@dataclasses.dataclass(frozen=True)
class Chance:
    """That one coupling is stable."""

    probability: float
    error: float  # Its standard error, as of independent devices
    nearness: float  # Its stiffness over the limit


@dataclasses.dataclass(frozen=True, eq=False)
class StableCouplings:
    """Limits of stable stiffness by damping, of one device or of N.

    Of one device the limits are exact, and every coupling below is stable with certainty.
    """

    setup: Setup
    largest_damping: float  # N·s/m, from which on no coupling is stable with any device
    knots: Array  # (B,) N·s/m; empty for one device
    limits: Array  # (N, B) N/m

    @classmethod
    def of(cls, setup: Setup) -> StableCouplings:
        """Work out the limits with the device, or with the first of the draws."""
        devices: list[AnyDevice] = [setup.device]
        if setup.draws is not None:
            count = min(_DEVICES, setup.draws.count)
            devices = [setup.draws.device(index) for index in range(count)]
        loop = setup.period, setup.hold, setup.velocity_filter
        largest = max(largest_coupling_damping(device, *loop) for device in devices)
        if setup.draws is None or not largest:
            return cls(setup, largest, np.empty(0), np.empty((0, 0)))
        knots = np.linspace(0.0, largest, _KNOTS)
        limits = np.array([stable_stiffness(device, knots, *loop) for device in devices])
        return cls(setup, largest, knots, limits)

    @property
    def devices(self) -> int | None:
        """Number of devices from a posterior; None without one."""
        return len(self.limits) or None

    def limit(self, damping: Array) -> Array:
        """Return the largest stiffness that is stable with any device, N/m, of damping's shape."""
        if not self.knots.size:
            setup = self.setup
            loop = setup.period, setup.hold, setup.velocity_filter
            return stable_stiffness(setup.device, damping, *loop)
        return np.interp(damping, self.knots, self.limits.max(axis=0))

    def probability(self, stiffness: Array, damping: Array) -> Array:
        """Return the probability that couplings (C,) below the limit are stable, (C,)."""
        if not self.knots.size:
            return np.ones(stiffness.shape)
        stable = np.zeros(stiffness.shape)
        for limits in self.limits:
            stable += stiffness <= np.interp(damping, self.knots, limits)
        return stable / len(self.limits)

    def chance(self, coupling: Coupling) -> Chance:
        """Return the probability that one coupling below the limit is stable."""
        stiffness = np.atleast_1d(coupling.stiffness)
        damping = np.atleast_1d(coupling.damping)
        probability = float(self.probability(stiffness, damping)[0])
        # One device is exact.
        error = share_error(probability, self.devices) if self.devices else 0.0
        nearness = float(stiffness[0] / self.limit(damping)[0])
        return Chance(probability, error, nearness)

    def allows(self, coupling: Coupling, decision: float) -> bool:
        """Whether a coupling is stable, or probably enough."""
        if not self.knots.size:
            return is_stable(self.setup, coupling)
        return self.chance(coupling).probability >= decision


def is_stable(setup: Setup, coupling: Coupling) -> bool:
    """Whether a coupling is stable with the device at its point."""
    stability = absolute_stability(setup.device, coupling, setup.period, hold=setup.hold)
    return stability.verdict == "stable"
