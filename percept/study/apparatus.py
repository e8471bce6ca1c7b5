"""The scene's device and coupling, as records of `percept.haptics`, and the references beside them."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept import haptics
from percept.errors import UsageError
from percept.haptics import AnyDevice, Coupling, Environment
from percept.scene import Scene

Array = NDArray[np.float64]
# Rows of a measured device that a grid starts from, at most twice as many.
_MOST_ROWS = 128


@dataclasses.dataclass(frozen=True, eq=False)
class Apparatus:
    """Device, period and references that curves are drawn for."""

    device: AnyDevice  # The device
    period: float  # Sampling period, s
    hold: str  # "average" (Eq
    references: dict[str, Environment]  # Reference environments by name
    coupling: Coupling | None  # The virtual coupling

    def curve(self, environment: str, omega: Array, *, coupled: bool) -> Array:
        """abs(Z_h) of a reference at frequencies (M,), rad/s, without or through the coupling, N·s/m."""
        return np.abs(
            haptics.perceived_impedance(
                omega,
                self.device,
                self.references[environment],
                self.period,
                coupling=self.coupling if coupled else None,
                hold=self.hold,
            )
        )

    def resonances(self, environment: str) -> Array:
        """Frequencies, rad/s, near which curves bend most: the device's mass on the reference, its modes."""
        device = self.device
        if not isinstance(device, haptics.Device):
            return device.omega[:: max(1, device.omega.size // _MOST_ROWS)]
        pairs = [(mode.stiffness, mode.mass) for mode in device.modes]
        pairs.append((self.references[environment].stiffness, device.mass))
        return np.array([float(np.sqrt(k / m)) for k, m in pairs if m])


def device_of(scene: Scene) -> haptics.AnyDevice | None:
    """Build the device that a scene describes."""
    table = scene.device
    if table is None:
        return None
    if table.response is not None:
        from percept.study.response_table import read_response

        # An absolute path stays what it is.
        file = str(scene.folder / table.response)
        measured = read_response(file)
        first, last = (float(measured.omega[end]) for end in (0, -1))
        for key, value in (("lower", scene.frequency.lower), ("upper", scene.frequency.upper)):
            if not first <= value <= last:
                raise UsageError(
                    f"the table covers {first:g} to {last:g} rad/s only, and nothing is extrapolated.",
                    file=file,
                    key=f"frequency.{key}",
                    value=value,
                    hint="Measure further, or narrow [frequency] of the scene.",
                )
        return measured
    assert table.mass is not None
    assert table.damping is not None
    modes = tuple(haptics.Mode(m.mass, m.stiffness, m.damping) for m in table.modes)
    return haptics.Device(mass=table.mass, damping=table.damping, modes=modes)


def coupling_of(scene: Scene) -> haptics.Coupling | None:
    """Build the virtual coupling that a scene describes; None without a `[coupling]`."""
    table = scene.coupling
    return None if table is None else haptics.Coupling(stiffness=table.stiffness, damping=table.damping)
