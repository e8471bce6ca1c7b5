"""The device, or draws of it, with coupling and references; what the paper says of the coupling.

The posterior of `[device]` is a file of draws, or a normal law of log parameters. Of a file, draws
in random order are taken; of a normal law, Sobol's points.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
from scipy import special

from percept import haptics
from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    TabulatedDevice,
    VelocityFilter,
)
from percept.haptics.arrays import complex_from
from percept.haptics.envelope import Ellipse, magnitude_envelope_ellipse
from percept.haptics.impedance import coupling_admittance
from percept.haptics.perceived import Display
from percept.haptics.records import AnyDevice
from percept.haptics.shown import departure
from percept.haptics.stability import coupling_bound
from percept.inference.record import Family
from percept.results import Coupling as JudgedCoupling
from percept.results import Membership, Shape, Skipped
from percept.scene import FrequencyTable, Scene
from percept.scene_device import DeviceTable
from percept.sessions.inputs import csv_frame
from percept.sessions.options import FileLimits
from percept.sessions.quantities import is_impedance
from percept.study.basics import Array, Stream, generator
from percept.study.data import Data
from percept.study.regions import Region

#: Curves around a rectangle of (k, b), by shape.
BOXES = {"corner": haptics.corner_curves, "envelope": haptics.magnitude_envelope}
_NO_DEVICE = "the scene has no [device]"
_RESPONSE_COLUMNS = ("omega", "real", "imaginary")
#: Rows of a measured device that a grid starts from, at most twice as many.
_MOST_ROWS = 128
#: Devices drawn, at most: 20 lie beyond a limit with a tail of 0.5 %. A power of two: Sobol's
#: points are then even.
_MOST_DRAWS = 4096
#: Draws that a file needs: of one draw there is no spread.
_FEWEST_DRAWS = 2
#: Frequencies that Eq. 10 is drawn at: enough for a line without corners.
_STABILITY_POINTS = 400
#: The criterion is drawn from here on, rad/s: far below Nyquist, unless a period takes seconds.
_LOWEST_OMEGA = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Setup:
    """Device, coupling and the references that curves are drawn for."""

    loop: Loop  # With the device
    references: Mapping[str, Environment]  # By environment
    coupling: Coupling | None = None
    #: N devices of its posterior, stacked, in an order in which the first few are spread over it.
    draws: Device | None = None

    @property
    def draw_count(self) -> int | None:
        """Number of devices of its posterior, N; None without one."""
        return None if self.draws is None else np.size(self.draws.mass)

    def with_device(self, device: AnyDevice) -> Setup:
        """Return the same with another device."""
        return dataclasses.replace(self, loop=dataclasses.replace(self.loop, device=device))

    def displays(self) -> Iterator[tuple[str, bool]]:
        """Yield each reference, and whether it is displayed through the coupling."""
        for environment in self.references:
            yield environment, False
            if self.coupling is not None:
                yield environment, True

    def display(self, environment: str, *, coupled: bool) -> Display:
        """Return a reference as it is displayed, without or through the coupling."""
        coupling = self.coupling if coupled else None
        return Display(self.loop, self.references[environment], coupling)

    def curve(self, environment: str, omega: Array, *, coupled: bool) -> Array:
        """abs(Z_h), N·s/m, of a reference at (M,) rad/s, directly or through the coupling."""
        display = self.display(environment, coupled=coupled)
        impedance = haptics.perceived_impedance(
            self.loop, omega, display.environment, coupling=display.coupling
        )
        return np.abs(impedance)

    def outline(self, region: Region, shape: Shape, omega: Array) -> tuple[Array, Array]:
        """Lower and upper curve of abs(Z_h) around a region at frequencies, rad/s, N·s/m."""
        mass = float(self.references[region.environment].mass)
        if region.ellipse is None:
            assert region.limits is not None
            return BOXES[shape](self.loop, omega, *region.limits, mass=mass)
        ellipse = region.ellipse
        log = ellipse.family == "lognormal"
        around = Ellipse(ellipse.centre, ellipse.shape, ellipse.radius, log)
        return magnitude_envelope_ellipse(self.loop, omega, around, mass=mass)

    def resonances(self, environment: str) -> Array:
        """Frequencies, rad/s, where curves bend most: device mass on the reference, modes.

        Shape (R,), or (N, R) of N devices.
        """
        device = self.loop.device
        if not isinstance(device, Device):
            return device.omega[:: max(1, device.omega.size // _MOST_ROWS)]
        pairs = [(mode.stiffness, mode.mass) for mode in device.modes]
        reference = self.references[environment]
        joint_stiffness = reference.stiffness + device.stiffness
        pairs.append((joint_stiffness, device.mass + reference.mass))
        omegas = [np.sqrt(np.divide(stiffness, mass)) for stiffness, mass in pairs if np.all(mass)]
        return np.stack(np.broadcast_arrays(*omegas), axis=-1) if omegas else np.array([])


def referenced(data: Data) -> Iterator[str | Skipped]:
    """Yield the environments with a reference of stiffness and damping, which curves need."""
    if not data.is_impedance:
        if data.scene.device is not None and is_impedance(data.quantities):
            why = f"only {data.quantities[data.parameters[0]].label} was adjusted"
            yield Skipped("boundaries", why)
        return
    for environment in data.environments:
        lacking = [
            data.quantities[parameter].label
            for parameter in data.parameters
            if not np.isfinite(data.reference[parameter, environment])
        ]
        if lacking:
            what = f"boundaries and band of {environment}"
            yield Skipped(what, f"it has no reference {' and '.join(lacking)}")
        else:
            yield environment


def setup_of(
    scene: Scene, device: AnyDevice | None, references: Mapping[str, Environment]
) -> Iterator[Setup | Skipped]:
    """Put the scene's device, coupling and references together, or say what there is none of."""
    if not is_impedance(scene.quantities):
        if scene.device or scene.coupling:
            yield Skipped("device and coupling", "the quantities make no impedance")
        return
    table = scene.coupling
    coupling = None
    if table is not None:
        coupling = Coupling(table.stiffness, table.damping)
    if scene.device is not None and device is not None:
        yield Setup(loop_of(scene.device, device), references, coupling, device_draws(scene))
    elif references:
        yield Skipped("boundaries of Z_h", _NO_DEVICE)
    if coupling is None:
        yield Skipped(
            "coupling: Z_h_vc, Eq. 10 and admissible couplings", "the scene has no [coupling]"
        )
    elif device is None:
        yield Skipped("coupling: Z_h_vc and Eq. 10", _NO_DEVICE)


def loop_of(table: DeviceTable, device: AnyDevice) -> Loop:
    """Return the loop that a scene's device is in."""
    velocity_filter = None
    if table.velocity_filter is not None:
        filter_table = table.velocity_filter
        velocity_filter = VelocityFilter(filter_table.cutoff, filter_table.order)
    return Loop(device, table.period, table.hold, velocity_filter, table.delay_in_samples)


def device_of(scene: Scene) -> AnyDevice | None:
    """Build the device that a scene describes; None without a `[device]`."""
    table = scene.device
    if table is None:
        return None
    if table.mass is not None and table.damping is not None:
        modes = tuple(haptics.Mode(mode.mass, mode.stiffness, mode.damping) for mode in table.modes)
        return Device(table.mass, table.damping, modes, table.stiffness)
    # An absolute path stays what it is.
    file = str(scene.folder / str(table.response))
    measured = read_response(file, scene.files)
    measured = dataclasses.replace(measured, floor=table.response_floor)
    first = float(measured.omega[0])
    last = float(measured.omega[-1])
    for name in ("lower", "upper"):
        value = getattr(scene.frequency, name)
        if not first <= value <= last:
            raise UsageError(
                f"the table covers {first:g} to {last:g} rad/s only, and nothing is extrapolated.",
                file=file,
                key=f"frequency.{name}",
                value=value,
                hint="Measure further, or narrow [frequency] of the scene.",
            )
    return measured


def read_response(path: str, limits: FileLimits) -> TabulatedDevice:
    """Read a CSV of a measured device: omega (rad/s) and Z_d, real and imaginary (N·s/m)."""
    table = _read_columns(path, _RESPONSE_COLUMNS, limits)
    try:
        omega, real, imaginary = (table[name].to_numpy(float) for name in _RESPONSE_COLUMNS)
        return TabulatedDevice(omega, complex_from(real, imaginary))
    except UsageError as error:
        error.file = path
        raise
    except ValueError as error:
        raise UsageError(f"cannot be read: {error}.", file=path) from error


def _read_columns(path: str, names: Sequence[str], limits: FileLimits) -> pd.DataFrame:
    """Read a CSV that has these columns."""
    table = csv_frame(path, limits)
    for name in names:
        if name not in table.columns:
            columns = ", ".join(table.columns)
            raise UsageError(f"There is no column {name!r}; there are {columns}.", file=path)
    return table


def device_draws(scene: Scene) -> Device | None:
    """Draw devices from the posterior of a scene's `[device]`; None without one.

    Parameters
    ----------
    scene : Scene
        Its device has mass and damping.

    Returns
    -------
    Device or None
        Of parameters (N,), in random order.

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
        drawn = drawn[rng.permutation(len(drawn))[:_MOST_DRAWS]]
    else:
        centre = np.log([values[name] for name in posterior.parameters])
        factor = np.linalg.cholesky(np.array(posterior.covariance))
        from scipy.stats import qmc  # slow to import, and needed here only

        points = qmc.Sobol(len(centre), rng=rng).random(_MOST_DRAWS)
        drawn = np.exp(centre + special.ndtri(points) @ factor.T)
    arrays = {name: np.full(len(drawn), value) for name, value in values.items()}
    arrays |= dict(zip(posterior.parameters, drawn.T, strict=True))
    modes = []
    for number in range(1, len(table.modes) + 1):
        parts = (arrays[f"mode {number} {part}"] for part in ("mass", "stiffness", "damping"))
        modes.append(haptics.Mode(*parts))
    return Device(arrays["mass"], arrays["damping"], tuple(modes), arrays["stiffness"])


def _read_draws(file: str, parameters: tuple[str, ...], limits: FileLimits) -> Array:
    """Read a CSV with a column per parameter and a row per draw, (N, d)."""
    table = _read_columns(file, parameters, limits)
    columns = []
    for name in parameters:
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(float)
        wrong = np.flatnonzero(~((values > 0.0) & np.isfinite(values)))
        if wrong.size:
            # Files count rows from one, below a row of names.
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


def study_coupling(
    setup: Setup, regions: Sequence[Region], family: Family, table: FrequencyTable
) -> JudgedCoupling:
    """Judge a coupling by Eq. 10 of the paper, and by its rule over the frequencies of a table."""
    within = table.lower, table.upper
    loop = setup.loop
    device = loop.device
    coupling = setup.coupling
    assert coupling is not None
    criterion = haptics.absolute_stability(loop, coupling)
    required = None
    if isinstance(device, haptics.Device):
        required = float(haptics.required_damping(loop, coupling).damping)
    rectangles = [one for one in regions if one.limits is not None and one.joint == "marginal"]
    # The next user's and Bayesian where there is one, of the scene's family.
    rectangles.sort(
        key=lambda one: (one.kind != "user", one.method != "bayesian", one.family != family)
    )
    best = {one.environment: one for one in reversed(rectangles)}
    memberships = [
        _membership(setup, best[name], within) for name in setup.references if name in best
    ]
    nyquist = loop.nyquist
    if isinstance(device, TabulatedDevice):
        omega = device.omega[device.omega <= nyquist]
    else:
        omega = np.geomspace(_LOWEST_OMEGA, nyquist, _STABILITY_POINTS)
    return JudgedCoupling(
        stiffness=float(coupling.stiffness),
        damping=float(coupling.damping),
        eq10=criterion.verdict,
        eq10_reason=criterion.reason,
        eq10_margin=float(criterion.smallest_margin),
        eq10_omega=float(criterion.binding_omega),
        required_damping=required,
        omega=omega,
        bound=coupling_bound(loop, omega),
        admittance=coupling_admittance(loop, omega, coupling).real,
        memberships=tuple(memberships),
    )


def _membership(setup: Setup, region: Region, within: tuple[float, float]) -> Membership:
    """Judge one reference by the paper's rule over a range of omega, rad/s."""
    assert region.limits is not None
    direct = setup.display(region.environment, coupled=False)
    coupled = setup.display(region.environment, coupled=True)
    return Membership(
        environment=region.environment,
        method=region.method,
        kind=region.kind,
        family=region.family,
        verdict_uncoupled=departure(direct, *region.limits, *within).verdict,
        verdict_coupled=departure(coupled, *region.limits, *within).verdict,
    )
