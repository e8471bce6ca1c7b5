"""Devices that a scene's posterior leaves likely, and what they render with every passive hand.

The posterior of `[device]` is a file of draws, or a normal law of log parameters. Of a file, draws
in random order are taken; of a normal law, Sobol's points.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd
from scipy import special

from percept.errors import UsageError
from percept.haptics import Coupling, Device, Environment, Loop, Mode
from percept.haptics.aliases import alias_features
from percept.haptics.loop import search_grid
from percept.haptics.rendering import needed_damping, rendering_load
from percept.results import DeviceStability
from percept.scene import Scene
from percept.sessions.options import FileLimits
from percept.sessions.typed import csv_frame
from percept.study.basics import Array, Stream, generator

#: Devices drawn, at most: 20 lie beyond a limit with a tail of 0.5 %. A power of two: Sobol's
#: points are then even.
_COUNT = 4096
#: Devices with modes whose margins are searched for: each takes a search over frequencies. As many
#: independent ones tell a probability to a standard error of 0.03, and Sobol's points a better one.
_SEARCHED = 256
#: Draws that a file needs: of one draw there is no spread.
_FEWEST_DRAWS = 2
#: Central share of the margins that is reported.
_LEVEL = 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class DeviceDraws:
    """N devices, spread over their posterior; the first few of them spread over it, too."""

    stacked: Device  # Of parameters (N,)

    @property
    def count(self) -> int:
        """Number of devices, N."""
        return np.size(self.stacked.mass)

    def device(self, index: int) -> Device:
        """Return one device."""
        return self.stacked.select(index)

    def first(self, count: int) -> DeviceDraws:
        """Return the first devices."""
        return DeviceDraws(self.stacked.select(slice(count)))


def device_draws(scene: Scene) -> DeviceDraws | None:
    """Draw devices from the posterior of a scene's `[device]`; None without one.

    Parameters
    ----------
    scene : Scene
        Its device has mass and damping.

    Returns
    -------
    DeviceDraws or None

    Raises
    ------
    UsageError
        A file of draws that cannot be read, lacks a parameter, has fewer than two draws, or holds a
        value that is not positive.
    """
    table = scene.device
    if table is None or table.posterior is None:
        return None
    posterior = table.posterior
    values = table.parameters
    rng = generator(scene.inference.seed, Stream.DEVICES)
    if posterior.draws is not None:
        file = str(scene.folder / posterior.draws)
        drawn = _read_draws(file, posterior.parameters, scene.files)
        drawn = drawn[rng.permutation(len(drawn))[:_COUNT]]
    else:
        centre = np.log([values[name] for name in posterior.parameters])
        factor = np.linalg.cholesky(np.array(posterior.covariance))
        from scipy.stats import qmc  # slow to import, and needed here only

        points = qmc.Sobol(len(centre), rng=rng).random(_COUNT)
        drawn = np.exp(centre + special.ndtri(points) @ factor.T)
    arrays = {name: np.full(len(drawn), value) for name, value in values.items()}
    arrays |= dict(zip(posterior.parameters, drawn.T, strict=True))
    modes = []
    for number in range(1, len(table.modes) + 1):
        parts = (arrays[f"mode {number} {part}"] for part in ("mass", "stiffness", "damping"))
        modes.append(Mode(*parts))
    stiffness = arrays["stiffness"]
    return DeviceDraws(Device(arrays["mass"], arrays["damping"], tuple(modes), stiffness))


def _read_draws(file: str, parameters: tuple[str, ...], limits: FileLimits) -> Array:
    """Read a CSV with a column per parameter and a row per draw, (N, d)."""
    table = csv_frame(file, limits)
    columns = []
    for name in parameters:
        if name not in table.columns:
            there = ", ".join(table.columns)
            raise UsageError(f"There is no column {name!r}; there are {there}.", file=file)
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(float)
        wrong = np.flatnonzero(~((values > 0.0) & np.isfinite(values)))
        if wrong.size:
            row = int(wrong[0])
            raise UsageError(
                "must be a positive number.",
                file=file,
                row=row + 2,
                column=name,
                value=table[name].iloc[row],
            )
        columns.append(values)
    if len(table) < _FEWEST_DRAWS:
        raise UsageError(
            f"The file has {len(table)} draws; a posterior needs {_FEWEST_DRAWS} or more.",
            file=file,
        )
    return np.column_stack(columns)


def margins_of_draws(
    draws: DeviceDraws, loop: Loop, environment: Environment | None, coupling: Coupling | None
) -> Array:
    """Return what each device dissipates over what is asked for, at its least.

    Parameters
    ----------
    draws : DeviceDraws
        N devices.
    loop : Loop
        That they are in; its own device does not count.
    environment : Environment or None
        None for a rigid wall behind the coupling.
    coupling : Coupling or None
        None where the environment is rendered directly.

    Returns
    -------
    ndarray, shape (N,)
        Ratios: above 1 the device renders with every passive hand. All rigid devices are judged,
        exactly. Of devices with modes the first 256 are, each on frequencies of its own.
    """
    needed = needed_damping(loop, environment, coupling=coupling).damping
    damping = np.asarray(draws.stacked.damping)
    with np.errstate(divide="ignore"):
        margins = np.asarray(damping / np.float64(needed))
    if not draws.stacked.modes or np.isinf(needed):
        return margins
    searched = draws.first(_SEARCHED)
    margins = margins[: searched.count]
    even = search_grid(dataclasses.replace(loop, device=Device(0.0, 0.0)))
    for index in range(searched.count):
        own = dataclasses.replace(loop, device=searched.device(index))
        omega = np.union1d(even, alias_features(own))
        load = rendering_load(own, omega, environment, coupling=coupling)
        # Modes only add to what the damping dissipates.
        margins[index] = max(margins[index], 1.0 / max(float(load.max()), np.finfo(float).tiny))
    return margins


def device_stability(
    draws: DeviceDraws, loop: Loop, environment: Environment | None, coupling: Coupling | None
) -> DeviceStability:
    """Say how probably a device renders, given what is known of it.

    Parameters as in `margins_of_draws`.

    Returns
    -------
    DeviceStability
        Its probability and the range of the margin.
    """
    margins = margins_of_draws(draws, loop, environment, coupling)
    tail = 0.5 * (1.0 - _LEVEL)
    lower, upper = np.quantile(margins, [tail, 1.0 - tail])
    stable = int(np.count_nonzero(margins > 1.0))
    # Laplace's rule of succession: one stable and one unstable device more are counted for the
    # error, which a share of 0 or 1 would not have otherwise.
    hedged = (stable + 1) / (margins.size + 2)
    return DeviceStability(
        probability=stable / margins.size,
        error=math.sqrt(hedged * (1.0 - hedged) / margins.size),
        draws=margins.size,
        level=_LEVEL,
        margin_lower=float(lower),
        margin_upper=float(upper),
    )
