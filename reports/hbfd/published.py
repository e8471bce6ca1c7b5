"""What the paper prints, the scene it is looked at in, and the evidence on its sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.haptics import (
    Coupling,
    Device,
    Environment,
    Loop,
    effective_impedance,
    perceived_impedance,
    required_damping,
)
from percept.haptics.rendering import needed_damping
from percept.inference import prediction_interval
from percept.published import PublishedLimits
from percept.scene import Scene
from percept.sessions import read_sessions
from reports import dataset

Array = NDArray[np.float64]
#: What braces in a text take: a number, a text, a list of them, numbers by name, or a record.
Value: TypeAlias = Any

#: Section 2.3: the coupling the theory gave, k_c in N/m and b_c in N·s/m (Eq. 6).
THEORETICAL = Coupling(110e3, 100.0)
#: Where Fig. 7 looks closely, rad/s.
LOOKED_AT = 10.0
#: Windows of its enlarged panels b, d and f, rad/s.
_WINDOWS = {"VE1": (9.89, 10.11), "VE2": (9.9, 10.1), "VE4": (9.3, 10.6)}
#: Points of ω that count shares of the perceivable range to four digits.
_DENSE = 100_001


@dataclass(frozen=True)
class Wall:
    """One row pair of Table 1."""

    name: str
    environment: Environment  # The reference
    lower: Environment  # Both printed lower limits of the mean
    upper: Environment  # Both printed upper limits

    @property
    def k(self) -> float:
        """Stiffness of the reference, N/m."""
        return float(self.environment.stiffness)

    @property
    def b(self) -> float:
        """Damping of the reference, N·s/m."""
        return float(self.environment.damping)

    @property
    def stiffness(self) -> tuple[float, float]:
        """Printed limits of the mean, N/m."""
        return float(self.lower.stiffness), float(self.upper.stiffness)

    @property
    def damping(self) -> tuple[float, float]:
        """Printed limits of the mean, N·s/m."""
        return float(self.lower.damping), float(self.upper.damping)


@dataclass(frozen=True, eq=False)
class Published:
    """The paper's numbers and the scene they are looked at in.

    Attributes
    ----------
    limits : PublishedLimits
        Table 1, with the digits as printed.
    scene : Scene
        A rigid device, the tuned coupling and the perceivable range.
    files : tuple of Path
        Where table and scene were read.
    """

    limits: PublishedLimits
    scene: Scene
    files: tuple[Path, ...] = ()

    @cached_property
    def walls(self) -> tuple[Wall, ...]:
        """The environments in the table's order."""
        walls = []
        for row, name in enumerate(self.limits.environments):
            reference = _environment(self.limits.reference[row])
            lower = _environment(self.limits.lower[row])
            upper = _environment(self.limits.upper[row])
            walls.append(Wall(name, reference, lower, upper))
        return tuple(walls)

    @property
    def softest_first(self) -> list[Wall]:
        """The environments by the stiffness of their references."""
        return sorted(self.walls, key=lambda wall: wall.k)

    @property
    def drawn(self) -> tuple[tuple[Wall, tuple[float, float]], ...]:
        """The environments of Fig. 7 with the window, rad/s, of each enlarged panel: b, d and f."""
        return tuple((wall, _WINDOWS[wall.name]) for wall in self.walls if wall.name in _WINDOWS)

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
    def loop(self) -> Loop:
        """The scene's device in the paper's loop."""
        return Loop(self.device, self.period)

    @property
    def tuned(self) -> Coupling:
        """The coupling found by tuning."""
        assert self.scene.coupling is not None
        return Coupling(self.scene.coupling.stiffness, self.scene.coupling.damping)

    @cached_property
    def next_user(self) -> Array:
        """Prediction limits, (environments, 2, 2): of k and b, lower and upper."""
        family = self.scene.inference.family
        limits = prediction_interval(self.limits.moments, level=self.limits.level, family=family)
        return np.stack([np.asarray(limits.lower), np.asarray(limits.upper)], axis=-1)

    def rendered(self, coupling: Coupling | None = None) -> dict[str, float]:
        """Return the device damping that each environment needs in time, N·s/m."""
        return {
            wall.name: float(needed_damping(self.loop, wall.environment, coupling=coupling).damping)
            for wall in self.walls
        }

    def needed(self, coupling: Coupling = THEORETICAL) -> float:
        """Return the damping a rigid device needs to carry a coupling (Eq. 10), N·s/m."""
        return float(required_damping(self.loop, coupling).damping)

    def felt(
        self,
        omega: Array | float,
        environment: Environment,
        *,
        coupling: Coupling | None = None,
        device: Device | None = None,
    ) -> Array:
        """Return |Z_h|, N·s/m, with the scene's device where no other is given."""
        loop = self.loop if device is None else Loop(device, self.period)
        z_h = perceived_impedance(loop, omega, environment, coupling=coupling)
        return np.abs(z_h)

    def through_coupling(self, wall: Wall, coupling: Coupling | None = None) -> tuple[float, float]:
        """Return k and b of a reference through a coupling, the tuned one, at `LOOKED_AT`."""
        joined = coupling or self.tuned
        k, b = effective_impedance(self.loop, LOOKED_AT, wall.environment, joined)
        return float(k), float(b)

    @property
    def span(self) -> tuple[float, float]:
        """The perceivable range, rad/s."""
        return self.scene.frequency.lower, self.scene.frequency.upper

    def omega(self, points: int = _DENSE) -> Array:
        """Return ω over the perceivable range, rad/s, shape (points,), evenly on a log scale."""
        return np.geomspace(*self.span, points)


def _environment(values: Sequence[Decimal]) -> Environment:
    k, b = values
    return Environment(float(k), float(b))


@dataclass(frozen=True)
class Evidence:
    """The cases that decide a verdict, and the values that `claims.toml` names in braces."""

    cases: list[bool] | None  # None where no published number decides
    values: Mapping[str, Value]


def evidence(cases: Iterable[object] | None, **values: Value) -> Evidence:
    """Return what decides, true or false in each case or nothing, and the values of the text."""
    return Evidence(None if cases is None else [bool(case) for case in cases], values)


def load_published() -> Published:
    """Read the paper's Table 1 and the scene that comes with it."""
    files = dataset("hbfd_table1.csv"), dataset("hbfd.toml")
    table, scene = files
    return Published(PublishedLimits.from_sessions(read_sessions(table)), Scene.load(scene), files)
