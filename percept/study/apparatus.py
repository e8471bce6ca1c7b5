"""The scene's device and coupling, as records of `percept.haptics`."""

from __future__ import annotations

from percept import haptics
from percept.scene import Scene

__all__ = ["coupling_of", "device_of"]


def device_of(scene: Scene) -> haptics.AnyDevice | None:
    """Build the device that a scene describes.

    Parameters
    ----------
    scene : Scene
        Mass, damping and modes, or a file of a measured response.

    Returns
    -------
    Device or TabulatedDevice or None
        None without a `[device]`.

    Raises
    ------
    UsageError
        Where the response cannot be read.
    """
    table = scene.device
    if table is None:
        return None
    if table.response is not None:
        from percept.study.response_table import read_response

        return read_response(table.response)
    assert table.mass is not None
    assert table.damping is not None
    modes = tuple(haptics.Mode(m.mass, m.stiffness, m.damping) for m in table.modes)
    return haptics.Device(mass=table.mass, damping=table.damping, modes=modes)


def coupling_of(scene: Scene) -> haptics.Coupling | None:
    """Build the virtual coupling that a scene describes; None without a `[coupling]`."""
    table = scene.coupling
    return None if table is None else haptics.Coupling(stiffness=table.stiffness, damping=table.damping)
