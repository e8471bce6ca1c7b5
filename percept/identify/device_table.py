"""The `[device]` of a scene, written from what was identified."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from percept.errors import RefusalError
from percept.identify.model import mode_names
from percept.identify.result import Identified, ParameterEstimate

__all__ = ["device_toml"]

_PARTS = ("mass", "stiffness", "damping")


def device_toml(found: Identified, period: float, source: str) -> str:
    """Write `[device]` with its posterior.

    Parameters
    ----------
    found : Identified
        The device.
    period : float
        Sampling period of the control loop, s.
    source : str
        Where the numbers come from, in a line.

    Returns
    -------
    str
        TOML. Modes that the log does not tell are left out, and named in a comment.

    Raises
    ------
    RefusalError
        Where the log does not tell the mass or the damping, without which there is no `[device]`.
    """
    by_name = {estimate.name: estimate for estimate in found.estimates}
    for name in ("mass", "damping"):
        if reason := by_name[name].not_identifiable:
            raise RefusalError(
                f"The log does not tell the {name}: {reason}. No [device] is written.",
                hint="Excite the device over a wider range of frequencies.",
            )
    kept = ["mass", "damping"]
    if found.terms.spring and not by_name["stiffness"].not_identifiable:
        kept.append("stiffness")
    written = list(kept)
    modes = []
    for mode in range(1, found.terms.modes + 1):
        names = mode_names(mode)
        if not any(by_name[name].not_identifiable for name in names):
            # A mode left out does not count: the posterior numbers those that are written.
            modes.append(names)
            kept += names
    lines = [f"# {source}"]
    if not found.fits:
        lines.append("# The device does not explain the log: its covariance is too small.")
    lines += [_comment(estimate) for estimate in found.estimates if estimate.name not in kept]
    lines += ["[device]", f"mass = {by_name['mass'].value!r}  # kg"]
    lines += [f"damping = {by_name['damping'].value!r}  # N·s/m"]
    if "stiffness" in written:
        lines.append(f"stiffness = {by_name['stiffness'].value!r}  # N/m, of a spring to ground")
    lines += [f"period = {period!r}  # s, of the control loop"]
    if modes:
        lines += ["modes = [", *[_mode(names, by_name) for names in modes], "]"]
    index = [list(by_name).index(name) for name in kept]
    covariance = found.covariance[np.ix_(index, index)].tolist()
    for number in range(1, len(modes) + 1):
        written += mode_names(number)
    quoted = ", ".join(f'"{name}"' for name in written)
    lines += ["", "[device.posterior]  # of the logarithms of these parameters"]
    lines += [f"parameters = [{quoted}]", "covariance = ["]
    lines += [f"  {row}," for row in covariance]
    lines += ["]", ""]
    return "\n".join(lines)


def _mode(names: list[str], by_name: Mapping[str, ParameterEstimate]) -> str:
    """Write a mode as a row of `modes`."""
    values = []
    for part, name in zip(_PARTS, names, strict=True):
        values.append(f"{part} = {by_name[name].value!r}")
    return f"  {{ {', '.join(values)} }},"


def _comment(estimate: ParameterEstimate) -> str:
    """Say what is known of a parameter of the log that `[device]` does not hold."""
    if estimate.not_identifiable:
        return f"# {estimate.name}: not identifiable, {estimate.not_identifiable}"
    return (
        f"# {estimate.name} of the log: {estimate.value:.6g} {estimate.unit}"
        f" (95 %: {estimate.lower:.6g} to {estimate.upper:.6g})"
    )
