"""What the paper prints, and the scene it is looked at in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Environment,
    effective_impedance,
    perceived_impedance,
    required_damping,
)
from percept.inference import prediction_interval
from percept.scene import Scene
from percept.sessions import read_sessions
from percept.simulate.like import PublishedLimits

Array = NDArray[np.float64]
#: The cases that decide a verdict, and the values that its text names; without cases it stays open.
Evidence = dict[str, Any]

#: Section 2.3: the coupling the theory gave, k_c in N/m and b_c in N·s/m (Eq. 6).
THEORETICAL = Coupling(110e3, 100.0)
#: Where Fig. 7 looks closely, rad/s.
LOOKED_AT = 10.0


@dataclass(frozen=True)
class Wall:
    """One row pair of Table 1."""

    name: str
    environment: Environment  # The reference
    stiffness: tuple[float, float]  # Printed limits of the mean, N/m
    damping: tuple[float, float]  # Printed limits of the mean, N·s/m

    @property
    def k(self) -> float:
        """Stiffness of the reference, N/m."""
        return float(self.environment.stiffness)

    @property
    def b(self) -> float:
        """Damping of the reference, N·s/m."""
        return float(self.environment.damping)


@dataclass(frozen=True, eq=False)
class Published:
    """The paper's numbers and the scene they are looked at in."""

    limits: PublishedLimits  # Table 1, digits kept
    scene: Scene  # Rigid device, tuned coupling, range, and in `report.zoom` the windows of Figs 7b, d and f
    files: tuple[Path, ...] = ()  # Table and scene

    def __post_init__(self) -> None:
        table, scene = map(str, self.files) if self.files else (None, None)
        if self.limits.parameters != ("k", "b"):
            raise UsageError("the table must have k and b.", file=table, column="parameter")
        device, windows = self.scene.device, self.scene.report.zoom
        rigid = device is not None and device.mass is not None and not device.modes
        drawn = len(windows) == 3 and set(windows) <= set(self.limits.environments)
        windows_needed = (
            "three windows are needed, as in Figs 7b, d and f, on environments of the table."
        )
        for given, key, message in (
            (rigid, "device", "the reproduction needs a rigid device: mass and damping."),
            (
                self.scene.coupling,
                "coupling",
                "the reproduction needs the coupling of section 2.3.",
            ),
            (drawn, "report.zoom", windows_needed),
        ):
            if not given:
                raise UsageError(message, file=scene, key=key)

    @cached_property
    def walls(self) -> tuple[Wall, ...]:
        """The environments in the table's order."""
        found = []
        for row, name in enumerate(self.limits.environments):
            (k, b), (k_low, b_low), (k_high, b_high) = (
                tuple(map(float, part[row]))
                for part in (self.limits.reference, self.limits.lower, self.limits.upper)
            )
            found.append(Wall(name, Environment(k, b), (k_low, k_high), (b_low, b_high)))
        return tuple(found)

    @property
    def drawn(self) -> tuple[tuple[Wall, tuple[float, float]], ...]:
        """The environments of Fig. 7 with the window, rad/s, of each enlarged panel: b, d and f."""
        by_name = {wall.name: wall for wall in self.walls}
        return tuple((by_name[name], window) for name, window in self.scene.report.zoom.items())

    @property
    def device(self) -> Device:
        """The scene's device."""
        table = self.scene.device
        assert table is not None
        return Device(table.mass or 0.0, table.damping or 0.0)

    @property
    def period(self) -> float:
        """Sampling period T, s."""
        assert self.scene.device is not None
        return self.scene.device.period

    @property
    def tuned(self) -> Coupling:
        """The coupling found by tuning."""
        assert self.scene.coupling is not None
        return Coupling(self.scene.coupling.stiffness, self.scene.coupling.damping)

    @cached_property
    def next_user(self) -> Array:
        """Prediction limits of the scene's family, (environments, 2, 2): of k and b, lower and upper."""
        limits = prediction_interval(
            self.limits.moments, level=self.limits.level, family=self.scene.inference.family
        )
        return np.stack([np.asarray(limits.lower), np.asarray(limits.upper)], axis=-1)

    def needed(self, coupling: Coupling = THEORETICAL) -> float:
        """Return the damping a rigid device needs to carry a coupling (Eq. 10), N·s/m."""
        return float(required_damping(coupling, self.period).damping)

    def felt(
        self,
        omega: Array | float,
        environment: Environment,
        *,
        coupling: Coupling | None = None,
        device: Device | None = None,
    ) -> Array:
        """Return |Z_h|, N·s/m, with the scene's device where no other is given."""
        device = self.device if device is None else device
        return np.abs(
            perceived_impedance(omega, device, environment, self.period, coupling=coupling)
        )

    def through_coupling(self, wall: Wall) -> tuple[float, float]:
        """Return k and b of a reference through the tuned coupling, at the ω where Fig. 7 looks closely."""
        k, b = effective_impedance(LOOKED_AT, wall.environment, self.tuned, self.period)
        return float(k), float(b)

    @property
    def span(self) -> tuple[float, float]:
        """The perceivable range, rad/s."""
        return self.scene.frequency.lower, self.scene.frequency.upper

    def omega(self, points: int = 241) -> Array:
        """Return ω over the perceivable range, rad/s, shape (points,), evenly on a logarithmic scale."""
        return np.geomspace(*self.span, points)


def load_published(table: str | Path | None = None, scene: str | Path | None = None) -> Published:
    """Read the published numbers.

    Parameters
    ----------
    table : str or Path, optional
        Limits as `percept.read_sessions` reads them; the paper's Table 1 by default.
    scene : str or Path, optional
        A scene file; by default the one that comes with the table.

    Returns
    -------
    Published
        The limits, the scene, and what follows from them.

    Raises
    ------
    UsageError
        A file that cannot be read or lacks what the reproduction needs.
    """
    files = (Path(table or dataset("hbfd_table1.csv")), Path(scene or dataset("hbfd.toml")))
    return Published(
        PublishedLimits.from_sessions(read_sessions(files[0])), Scene.load(files[1]), files
    )


def dataset(name: str) -> Path:
    """Return a data set: inside an installed package, or next to it in a checkout."""
    inside = Path(str(resources.files("percept").joinpath("datasets", name)))
    return inside if inside.is_file() else Path(__file__).resolve().parents[2] / "datasets" / name
