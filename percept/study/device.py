"""The device with its coupling and references: what it displays, and what other devices would."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept import haptics
from percept.errors import UsageError
from percept.haptics import Coupling, Device, Environment, TabulatedDevice
from percept.haptics.containment import ON_LIMIT, Boxes, departures
from percept.haptics.envelope import Ellipse, magnitude_envelope_ellipse
from percept.haptics.limits import passivity_damping
from percept.haptics.records import AnyDevice, Display
from percept.results import Sensitivity, Shape
from percept.scene import InferenceTable, Scene
from percept.sessions.quantities import is_impedance
from percept.study.basics import Array, Skipped
from percept.study.regions import Region

__all__ = [
    "BOXES",
    "Setup",
    "device_of",
    "device_sensitivity",
    "fixed_device",
    "read_response",
    "setup_of",
]

#: Curves around a rectangle of (k, b), by shape.
BOXES = {"corner": haptics.corner_curves, "envelope": haptics.magnitude_envelope}
_NO_DEVICE = "the scene has no [device]"
_RESPONSE = ("omega", "real", "imaginary")
# Rows of a measured device that a grid starts from, at most twice as many.
_MOST_ROWS = 128
# Of the scene's mass and damping, for the devices that verdicts are given for.
_TIMES = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Setup:
    """Device, coupling and the references that curves are drawn for."""

    device: AnyDevice
    period: float  # Sampling period, s
    hold: str  # "average" (Eq. 8) or "true"
    references: Mapping[str, Environment]  # By environment
    coupling: Coupling | None = None

    def display(self, environment: str, *, coupled: bool) -> Display:
        """Return a reference as it is displayed, without or through the coupling."""
        coupling = self.coupling if coupled else None
        return Display(self.device, self.references[environment], self.period, coupling, self.hold)

    def curve(self, environment: str, omega: Array, *, coupled: bool) -> Array:
        """abs(Z_h), N·s/m, of a reference at (M,) rad/s, directly or through the coupling."""
        impedance = haptics.perceived_impedance(
            omega,
            self.device,
            self.references[environment],
            self.period,
            coupling=self.coupling if coupled else None,
            hold=self.hold,
        )
        return np.abs(impedance)

    def outline(self, region: Region, shape: Shape, omega: Array) -> tuple[Array, Array]:
        """Lower and upper curve of abs(Z_h) around a region at frequencies, rad/s, N·s/m."""
        mass = float(self.references[region.environment].mass)
        if region.ellipse is None:
            assert region.limits is not None
            return BOXES[shape](
                omega, self.device, *region.limits, self.period, mass=mass, hold=self.hold
            )
        ellipse = region.ellipse
        log = ellipse.family == "lognormal"
        around = Ellipse(ellipse.centre, ellipse.shape, ellipse.radius, log)
        return magnitude_envelope_ellipse(
            omega, self.device, around, self.period, mass=mass, hold=self.hold
        )

    def resonances(self, environment: str) -> Array:
        """Frequencies, rad/s, where curves bend most: device mass on the reference, modes."""
        device = self.device
        if not isinstance(device, Device):
            return device.omega[:: max(1, device.omega.size // _MOST_ROWS)]
        pairs = [(mode.stiffness, mode.mass) for mode in device.modes]
        reference = self.references[environment]
        pairs.append((reference.stiffness, device.mass + reference.mass))
        return np.array([float(np.sqrt(k / m)) for k, m in pairs if m])

    @property
    def passivity(self) -> pd.DataFrame:
        """One-port passivity of every reference, rendered without the coupling."""
        rows = []
        if isinstance(self.device, Device):
            damping = self.device.damping
            for name, reference in self.references.items():
                colgate, tustin = map(float, passivity_damping(reference, self.period))
                rows.append((name, colgate, tustin, damping, bool(damping > colgate)))
        columns = ["environment", "needed_colgate", "needed_paper", "device_damping", "passive"]
        return pd.DataFrame(rows, columns=columns)


def setup_of(
    scene: Scene, device: AnyDevice | None, references: Mapping[str, Environment]
) -> Iterator[Setup | Skipped]:
    """Put the scene's device, coupling and references together, or say what there is none of."""
    if not is_impedance(scene.quantities):
        if scene.device or scene.coupling:
            yield Skipped("device and coupling", "the quantities make no impedance")
        return
    table = scene.coupling
    coupling = None if table is None else Coupling(stiffness=table.stiffness, damping=table.damping)
    if scene.device is not None and device is not None:
        yield Setup(device, scene.device.period, scene.device.hold, references, coupling)
    elif references:
        yield Skipped("boundaries of Z_h", _NO_DEVICE)
    if coupling is None:
        yield Skipped(
            "coupling: Z_h_vc, stability and admissible couplings", "the scene has no [coupling]"
        )
    elif device is None:
        yield Skipped("coupling: Z_h_vc and stability", _NO_DEVICE)


def device_of(scene: Scene) -> AnyDevice | None:
    """Build the device that a scene describes; None without a `[device]`."""
    table = scene.device
    if table is None:
        return None
    if table.mass is not None and table.damping is not None:
        modes = tuple(haptics.Mode(m.mass, m.stiffness, m.damping) for m in table.modes)
        return Device(mass=table.mass, damping=table.damping, modes=modes)
    # An absolute path stays what it is.
    file = str(scene.folder / str(table.response))
    measured = read_response(file)
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


def read_response(path: str) -> TabulatedDevice:
    """Read a CSV of a measured device: omega (rad/s) and Z_d, real and imaginary (N·s/m)."""
    try:
        table = pd.read_csv(path)
        for name in _RESPONSE:
            if name not in table.columns:
                columns = ", ".join(table.columns)
                raise UsageError(f"the column is missing; there are {columns}.", column=name)
        impedance = np.empty(len(table), dtype=complex)
        # Part by part: 1j times an infinite number is not a number.
        impedance.real = table["real"].to_numpy(float)
        impedance.imag = table["imaginary"].to_numpy(float)
        return TabulatedDevice(omega=table["omega"].to_numpy(float), impedance=impedance)
    except UsageError as error:
        error.file = path
        raise
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot be read: {error}.", file=path) from error


def fixed_device(setup: Setup, method: str) -> Skipped | None:
    """Say why mass and damping are not varied; None where they are."""
    what = "sensitivity to the device's mass and damping"
    if not isinstance(setup.device, Device):
        return Skipped(what, "a measured response has neither")
    if method == "bayesian":
        return Skipped(what, "it is worked out for classical intervals")
    return None


def device_sensitivity(
    setup: Setup, regions: Sequence[Region], asked: InferenceTable, within: tuple[float, float]
) -> Sensitivity | None:
    """Judge stability and realism again for 49 devices about the scene's; None without a region."""
    device = setup.device
    assert isinstance(device, Device)
    rectangles: dict[str, list[Region]] = {}
    for kind in asked.kinds:
        of_kind = _rectangles(setup, regions, kind, asked.family)
        if of_kind:
            rectangles[str(kind)] = of_kind
    if not rectangles:
        return None
    masses = _about(float(device.mass))
    dampings = _about(float(device.damping))
    inside: dict[str, tuple[tuple[int, ...], ...]] = {}
    for name, of_kind in rectangles.items():
        counts = _counts_inside(setup, of_kind, masses, dampings, within)
        inside[name] = tuple(tuple(row) for row in counts.tolist())
    needed = None
    if setup.coupling is not None:
        need = haptics.required_damping(setup.coupling, setup.period, hold=setup.hold)
        needed = float(need.damping)
    first_kind = next(iter(rectangles.values()))
    return Sensitivity(
        mass=masses,
        damping=dampings,
        own=(dampings.index(float(device.damping)), masses.index(float(device.mass))),
        verdict=tuple(tuple(_stability(setup, masses, damping)) for damping in dampings),
        inside=inside,
        environments=len(first_kind),
        required_damping=needed,
        method="classical",
        family=" or ".join(dict.fromkeys(region.family for region in first_kind)),
    )


def _stability(setup: Setup, masses: Sequence[float], damping: float) -> Iterator[str | None]:
    """Yield Llewellyn's verdict for every mass, kg, at one damping; None without a coupling."""
    assert isinstance(setup.device, Device)
    for mass in masses:
        if setup.coupling is None:
            yield None
            continue
        device = dataclasses.replace(setup.device, mass=mass, damping=damping)
        stability = haptics.absolute_stability(
            device, setup.coupling, setup.period, hold=setup.hold
        )
        yield str(stability.verdict)


def _counts_inside(
    setup: Setup,
    rectangles: Sequence[Region],
    masses: Sequence[float],
    dampings: Sequence[float],
    within: tuple[float, float],
) -> NDArray[np.int64]:
    """Count environments whose abs(Z_h) stays inside, (dampings, masses), for all devices."""
    assert isinstance(setup.device, Device)
    damping, mass = np.meshgrid(dampings, masses, indexing="ij")
    devices = dataclasses.replace(setup.device, mass=mass.ravel(), damping=damping.ravel())
    of_devices = dataclasses.replace(setup, device=devices)
    counts = np.zeros(mass.size, dtype=np.int64)
    for region in rectangles:
        assert region.limits is not None
        boxes = Boxes.of(*region.limits, count=mass.size)
        display = of_devices.display(region.environment, coupled=setup.coupling is not None)
        departed = departures(display, boxes, *within, throughout=True)
        counts += departed.largest <= ON_LIMIT
    return counts.reshape(mass.shape)


def _about(value: float) -> tuple[float, ...]:
    """Return values about the scene's; multiples of one where the scene's is zero."""
    if value:
        return tuple(value * times for times in _TIMES)
    return (0.0, *_TIMES[1:])


def _rectangles(setup: Setup, regions: Sequence[Region], kind: str, family: str) -> list[Region]:
    """Return classical rectangles of a kind, one per environment, of the scene's family first."""
    chosen: dict[str, Region] = {}
    # The one set last stays.
    for preferred in ("normal", "lognormal", family):
        for region in regions:
            labels = region.method, region.kind, region.joint, region.family
            if labels == ("classical", kind, "marginal", preferred):
                chosen[region.environment] = region
    return [chosen[environment] for environment in setup.references if environment in chosen]
