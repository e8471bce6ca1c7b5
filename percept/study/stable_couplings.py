"""Which couplings are stable in time, for some environments, with the device or its posterior."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from percept.boundary.feels_real import share_error
from percept.haptics import Coupling, Device, Environment
from percept.haptics.rendering import needed_damping, rendering_margins
from percept.study.basics import Array
from percept.study.device import Setup

#: A coupling that needs as many times what the environments need directly shows itself by a tenth
#: at most: it counts as rigid.
_RIGID = 10.0
#: Halvings of a line: its limit is known to a part in 10⁸ of its range.
_HALVINGS = 27


@dataclasses.dataclass(frozen=True)
class Chance:
    """That one coupling is stable."""

    probability: float
    error: float  # Its standard error, as of independent devices


@dataclasses.dataclass(frozen=True, eq=False)
class StableCouplings:
    """Couplings through which the device renders some environments with every passive hand."""

    setup: Setup
    environments: tuple[str, ...]
    rigid: float  # N·s/m, the coupling's k_cT/2 + b_c from which on it counts as rigid

    @classmethod
    def of(cls, setup: Setup, environments: Sequence[str]) -> StableCouplings:
        """Prepare environments; the largest of the study sets where couplings count as rigid."""
        largest = max(_at_nyquist(setup, shown) for shown in setup.references.values())
        used = 0.0
        if setup.coupling is not None:
            used = _at_nyquist(setup, setup.coupling)
        return cls(setup, tuple(environments), max(_RIGID * largest, 2.0 * used))

    @property
    def devices(self) -> int | None:
        """Number of devices from a posterior; None without one."""
        return None if self.setup.draws is None else self.setup.draws.count

    def probability(self, stiffness: Array, damping: Array) -> Array:
        """Return the probability that couplings (C,) are stable, (C,): 0 or 1 for one device.

        Of a posterior's devices with modes the damping alone counts: that is on the safe side.
        """
        couplings = Coupling(stiffness, damping)
        likely = np.ones(stiffness.shape)
        device = self.setup.loop.device
        if self.setup.draws is None and (not isinstance(device, Device) or device.modes):
            for margins in self._of_each(couplings, self._margins):
                likely = np.minimum(likely, margins > 1.0)
            return likely
        dampings = np.atleast_1d(np.asarray(getattr(device, "damping", 0.0)))
        if self.setup.draws is not None:
            dampings = np.sort(np.asarray(self.setup.draws.stacked.damping))
        for needed in self._of_each(couplings, self._needed):
            below = np.searchsorted(dampings, needed, side="right")
            likely = np.minimum(likely, 1.0 - below / dampings.size)
        return likely

    def chance(self, coupling: Coupling) -> Chance:
        """Return the probability that one coupling is stable."""
        some = np.atleast_1d(coupling.stiffness), np.atleast_1d(coupling.damping)
        probability = float(self.probability(*some)[0])
        # One device is exact.
        error = share_error(probability, self.devices) if self.devices else 0.0
        return Chance(probability, error)

    def largest_damping(self) -> float:
        """Return the largest b_c that is stable without a spring, N·s/m; 0 without any."""
        top = np.array([self.rigid])
        return float(_limit(lambda part: self.probability(0.0 * top, part * top))[0] * top[0])

    def limit(self, damping: Array) -> Array:
        """Return the largest stiffness beside each damping that may be stable, N/m.

        It ends where couplings count as rigid.
        """
        top = np.maximum(self.rigid - damping, 0.0) * (2.0 / self.setup.loop.period)
        return top * _limit(lambda part: self.probability(part * top, damping))

    def _of_each(self, couplings: Coupling, judge: Callable[[str, Coupling], Array]) -> list[Array]:
        return [judge(environment, couplings) for environment in self.environments]

    def _needed(self, environment: str, couplings: Coupling) -> Array:
        """Return the damping that a rigid device needs, N·s/m."""
        shown = self.setup.references[environment]
        return np.asarray(needed_damping(self.setup.loop, shown, coupling=couplings).damping)

    def _margins(self, environment: str, couplings: Coupling) -> Array:
        shown = self.setup.references[environment]
        return rendering_margins(self.setup.loop, shown, coupling=couplings)


def _at_nyquist(setup: Setup, shown: Environment | Coupling) -> float:
    """Return what a spring and a damper ask for at Nyquist, N·s/m."""
    return float(0.5 * shown.stiffness * setup.loop.period + shown.damping)


def _limit(probability: Callable[[Array], Array]) -> Array:
    """Return the largest part of each line, 0 to 1, that may be stable, by halving.

    1 where all of it is, 0 where not even its beginning.
    """
    none = np.zeros_like(probability(np.array(1.0)))
    inside = none
    outside = none + 1.0
    whole = probability(outside) > 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        some = probability(middle) > 0.0
        inside = np.where(some, middle, inside)
        outside = np.where(some, outside, middle)
    return np.where(whole, 1.0, inside)
