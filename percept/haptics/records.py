"""What is connected to what: devices, environments and couplings, checked when they are made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics.arrays import (
    LARGEST,
    ComplexArray,
    FloatArray,
    IntArray,
    Scalars,
    complex_array,
    nonnegative_array,
    stored,
)
from percept.html import NotebookRecord

_UNITS = {"stiffness": "N/m", "damping": "N·s/m", "mass": "kg"}


class _Parameters:
    """Checks the fields named in `_UNITS` when a record is made: real, finite, not negative."""

    def __post_init__(self) -> None:
        for name, value in self.parameters().items():
            checked = nonnegative_array(value, f"{type(self).__name__} {name}", _UNITS[name])
            object.__setattr__(self, name, stored(checked))

    def parameters(self) -> dict[str, Scalars]:
        """Return the fields that are numbers or arrays, by name."""
        return {name: getattr(self, name) for name in _UNITS if hasattr(self, name)}

    def select(self, which: int | slice | IntArray) -> Self:
        """Return one of several such records, or some; single numbers hold for all."""
        some = {}
        for name, value in self.parameters().items():
            some[name] = np.asarray(value)[which] if np.ndim(value) else value
        return replace(self, **some)  # type: ignore[type-var]  # every subclass is a dataclass

    def flat(self, shape: tuple[int, ...]) -> Self:
        """Broadcast the fields to a shape, and take them flat."""
        parameters = self.parameters().items()
        all_flat = {name: np.broadcast_to(value, shape).ravel() for name, value in parameters}
        return replace(self, **all_flat)  # type: ignore[type-var]  # every subclass is a dataclass


@dataclass(frozen=True)
class Environment(_Parameters):
    """A virtual environment, Z_e = m·s + b + k/s (Eq. 7).

    Parameters
    ----------
    stiffness : float or array_like
        k, N/m, zero or more.
    damping : float or array_like
        b, N·s/m, zero or more.
    mass : float or array_like, optional
        m, kg, zero or more.

    Raises
    ------
    UsageError
        Where a value is negative, NaN, infinite or not a number.

    Notes
    -----
    Arrays broadcast against ω and each other by numpy's rules: with ω of shape (n, 1, 1), stiffness
    and damping of shape (environments, draws) give results of shape (n, environments, draws).
    """

    stiffness: Scalars
    damping: Scalars
    mass: Scalars = 0.0


@dataclass(frozen=True)
class Coupling(_Parameters):
    """A virtual coupling, Z_c = b + k/s (Eq. 6 or 12).

    Parameters
    ----------
    stiffness : float or array_like
        k_c, N/m, zero or more.
    damping : float or array_like
        b_c, N·s/m, zero or more.

    Raises
    ------
    UsageError
        Where a value is negative, NaN, infinite or not a number.
    """

    stiffness: Scalars
    damping: Scalars


@dataclass(frozen=True)
class Mode(_Parameters):
    """One flexible mode of a device: a mass carried by a spring and a damper.

    Its impedance at the handle, m·s(b·s + k)/(m·s² + b·s + k), is passive whatever the numbers.

    Parameters
    ----------
    mass : float or array_like
        kg, zero or more.
    stiffness : float or array_like
        N/m, zero or more.
    damping : float or array_like
        N·s/m, zero or more.

    Raises
    ------
    UsageError
        Where a value is negative, NaN, infinite or not a number.
    """

    mass: Scalars
    stiffness: Scalars
    damping: Scalars

    @property
    def resonance(self) -> float:
        """Ω at which mass and spring of a single mode resonate, rad/s; 0 without a mass."""
        return float(np.sqrt(self.stiffness / self.mass)) if self.mass else 0.0


@dataclass(frozen=True)
class Device(_Parameters):
    """A haptic device, Z_d = m·s + b + k/s (Eq. 5 with k = 0), with modes where there are any.

    Parameters
    ----------
    mass : float or array_like
        kg, zero or more.
    damping : float or array_like
        N·s/m, zero or more.
    modes : iterable of Mode, optional
        Each adds its own impedance.
    stiffness : float or array_like, optional
        Of a spring to ground, N/m, zero or more. It stores energy and gives it back, so stability
        does not ask for it.

    Raises
    ------
    UsageError
        Where a value is negative, NaN, infinite or not a number, or a mode is not a `Mode`.
    """

    mass: Scalars
    damping: Scalars
    modes: tuple[Mode, ...] = ()
    stiffness: Scalars = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        modes = tuple(self.modes)
        for mode in modes:
            if not isinstance(mode, Mode):
                raise UsageError("Device modes must be Mode records.", value=mode)
        object.__setattr__(self, "modes", modes)

    def select(self, which: int | slice | IntArray) -> Device:
        """Return one of several devices, or some; single numbers hold for all."""
        some = super().select(which)
        return replace(some, modes=tuple(mode.select(which) for mode in self.modes))


@dataclass(frozen=True, eq=False)
class TabulatedDevice:
    """A device known by its measured impedance, interpolated linearly and never extrapolated.

    Parameters
    ----------
    omega : array_like, shape (n,)
        rad/s, zero or more, increasing, at least two.
    impedance : array_like of complex, shape (n,)
        Z_d, N·s/m.
    floor : float, optional
        The least Re Z_d above the table's end, N·s/m, above zero; unknown by default.

    Raises
    ------
    UsageError
        Where the table is too short, unordered, of unequal lengths, or holds a value that is not
        finite; where the floor is not above zero.
    """

    omega: FloatArray
    impedance: ComplexArray
    floor: float | None = None

    def __post_init__(self) -> None:
        omega = nonnegative_array(self.omega, "TabulatedDevice omega", "rad/s")
        impedance = complex_array(self.impedance, "TabulatedDevice impedance", "N·s/m")
        if omega.ndim != 1 or omega.size < 2 or impedance.shape != omega.shape:
            raise UsageError(
                "TabulatedDevice needs omega and impedance of equal length, two or more.",
                value=(omega.shape, impedance.shape),
            )
        if np.any(np.diff(omega) <= 0):
            row = int(np.flatnonzero(np.diff(omega) <= 0)[0]) + 1
            raise UsageError(
                "TabulatedDevice omega must increase.",
                value=float(omega[row]),
                hint="Sort the table, drop repeats.",
            )
        if self.floor is not None and not 0 < self.floor <= LARGEST:
            raise UsageError(
                "the floor of a TabulatedDevice must be above zero, in N·s/m.", value=self.floor
            )
        omega.flags.writeable = impedance.flags.writeable = False
        object.__setattr__(self, "omega", omega)
        object.__setattr__(self, "impedance", impedance)

    def at(self, omega: ArrayLike) -> ComplexArray:
        """Return Z_d at ω, linear between rows.

        Parameters
        ----------
        omega : array_like
            rad/s; negative ω gives the conjugate.

        Returns
        -------
        ndarray of complex
            N·s/m, of ω's shape.

        Raises
        ------
        UsageError
            ω outside the table.
        """
        omega = np.asarray(omega, dtype=np.float64)
        size = np.abs(omega)
        outside = ~((size >= self.omega[0]) & (size <= self.omega[-1]))
        if outside.any():
            raise UsageError(
                f"the device's table covers {self.omega[0]:g} to {self.omega[-1]:g} rad/s only.",
                value=float(omega[outside][0]),
                hint="Measure further, or narrow the frequency range; nothing is extrapolated.",
            )
        value = np.interp(size, self.omega, self.impedance)
        return np.where(omega < 0, np.conj(value), value)


@dataclass(frozen=True)
class NeededDamping(NotebookRecord):
    """Damping that a rigid device needs, for what it renders or by Eq. 10.

    Floats, or of the parameters' shape.
    """

    damping: Scalars  # N·s/m; inf where no damping suffices
    omega: Scalars  # The ω that binds, rad/s


AnyDevice: TypeAlias = Device | TabulatedDevice
"""What every argument called `device` accepts."""


def joint_shape(*records: AnyDevice | Environment | Coupling | None) -> tuple[int, ...]:
    """Return the shape that the parameters of records broadcast to; a table and None have none."""
    shapes = []
    for record in records:
        if isinstance(record, _Parameters):
            shapes += [np.shape(value) for value in record.parameters().values()]
    return np.broadcast_shapes(*shapes)


def refuse_arrays(
    device: AnyDevice, coupling: Coupling | None, environment: Environment | None = None
) -> None:
    """Refuse arrays where one verdict is asked for."""
    records = [device, coupling, environment, *getattr(device, "modes", ())]
    for record in records:
        if not isinstance(record, _Parameters):
            continue
        if any(np.ndim(value) for value in record.parameters().values()):
            raise UsageError(
                "a verdict is for one device, one environment and one coupling.",
                hint="For arrays use needed_damping, stability_margin or required_damping.",
            )
