"""Which couplings are stable in time, for some environments, with the device or its posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import elementwise

from percept.haptics import Coupling, Device, Environment
from percept.haptics.arrays import LARGEST
from percept.haptics.rendering import needed_damping, rendering_margins
from percept.study.basics import Array
from percept.study.device import Setup

#: A coupling that needs as many times what the environments need directly shows itself by a tenth
#: at most: it counts as rigid.
_RIGID = 10.0


class StableCouplings:
    """Couplings through which the device renders some environments with every passive hand.

    Of a posterior's devices with modes the damping alone counts: that is on the safe side.
    """

    def __init__(self, setup: Setup, environments: Sequence[str]) -> None:
        self.loop = setup.loop
        #: Number of devices from a posterior; None without one.
        self.devices = None if setup.draws is None else setup.draws.count
        self._environments = [setup.references[name] for name in environments]
        # What each device gives: its damping, N·s/m, or all that it dissipates.
        device = self.loop.device
        self._given = np.ones(1)
        if setup.draws is not None:
            self._given = np.sort(np.asarray(setup.draws.stacked.damping))
        elif isinstance(device, Device) and not device.modes:
            self._given = np.atleast_1d(device.damping)
        self._by_damping = isinstance(device, Device) and (
            setup.draws is not None or not device.modes
        )
        largest = max(self.at_nyquist(shown) for shown in setup.references.values())
        used = 0.0 if setup.coupling is None else self.at_nyquist(setup.coupling)
        #: N·s/m, what a coupling asks for at Nyquist from which on it counts as rigid.
        self.rigid = max(_RIGID * largest, 2.0 * used)

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
        top = np.array([self.rigid])
        return float(self._limit(lambda damping: self._asked(0.0 * damping, damping), top)[0])

    def limit(self, damping: Array) -> Array:
        """Return the largest stiffness beside each damping (B,) that may be stable, N/m, (B,).

        It ends where couplings count as rigid.
        """
        top = np.maximum(self.rigid - damping, 0.0) * (2.0 / self.loop.period)
        return self._limit(self._asked, top, damping)

    def _limit(self, asked: Callable[..., Array], top: Array, *beside: Array) -> Array:
        """Return up to where each line, from zero to its top, asks for less than a device gives."""
        most = self._given[-1]
        found = elementwise.find_root(
            lambda value, *beside: asked(value, *beside) - most, (0.0 * top, top), args=beside
        )
        limit = np.where(found.success, found.x, 0.0)
        return np.where(asked(top, *beside) < most, top, limit)
