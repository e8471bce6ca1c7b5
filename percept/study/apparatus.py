"""The scene's device and coupling, as records of `percept.haptics`."""

from __future__ import annotations

from percept import haptics
from percept.errors import UsageError
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
        Where the response cannot be read, or does not cover the scene's frequencies.
    """
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
