"""Reading a log: force and motion in time, or a response as a spectrum analyser writes it."""

from __future__ import annotations

import dataclasses
import re
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.errors import UsageError
from percept.identify.spectra import Spectra, TimeLog, of_response

__all__ = ["QUANTITIES", "Response", "read_log"]

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class _Definition(NamedTuple):
    """How a response is defined, against an impedance: force over velocity."""

    motion_over_force: bool
    derivative: int  # Of the motion, from velocity: -1 is position, 1 is acceleration


#: Responses by name.
QUANTITIES = {
    "impedance": _Definition(motion_over_force=False, derivative=0),
    "mobility": _Definition(motion_over_force=True, derivative=0),
    "dynamic stiffness": _Definition(motion_over_force=False, derivative=-1),
    "receptance": _Definition(motion_over_force=True, derivative=-1),
    "apparent mass": _Definition(motion_over_force=False, derivative=1),
    "accelerance": _Definition(motion_over_force=True, derivative=1),
}
#: Other words for a column.
_ALIASES = {
    "t": "time", "f": "frequency", "freq": "frequency", "ω": "omega", "mag": "magnitude",
    "re": "real", "im": "imaginary", "imag": "imaginary", "coh": "coherence",
}  # fmt: skip
#: Factors that take the units of a column to SI. A column without a unit has the first of them.
#: Real and imaginary parts and magnitudes have the SI unit of their quantity, or are in dB.
_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3},
    "force": {"n": 1.0, "mn": 1e-3},
    "position": {"m": 1.0, "mm": 1e-3},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "frequency": {"hz": 1.0},
    "omega": {"rad/s": 1.0},
    "real": {},
    "imaginary": {},
    "magnitude": {},
    "phase": {"deg": np.pi / 180.0, "°": np.pi / 180.0, "rad": 1.0},
    "coherence": {},
}
#: dB in a factor of ten of a magnitude.
_DECIBELS_PER_DECADE = 20.0
#: A column's name, and its unit in brackets where it has one.
_TITLE = re.compile(r"\s*(?P<name>[^(\[]*?)\s*(?:[(\[](?P<unit>.*)[)\]])?\s*")
#: Fraction of a step by which steps of time may differ: clocks are rounded.
_MOST_UNEVEN = 0.01
#: Variance of a third difference, in variances of what is differenced: 1 + 9 + 9 + 1.
_THIRD_DIFFERENCE = 20.0
#: Median over mean of an exponential law, which the squares of complex noise follow.
_MEDIAN_OVER_MEAN = np.log(2.0)
#: Distance from zero and one to which a coherence is moved: analysers round it to either.
_COHERENCE_SLACK = 1e-6
#: Number in its file of the first row of a table: the header is row 1.
_FIRST_ROW = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Response:
    """An impedance by frequency."""

    omega: Array  # (K,) rad/s
    impedance: ComplexArray  # (K,) N·s/m
    coherence: Array | None  # (K,)

    def spectra(self, averages: int | None, band: tuple[float, float]) -> Spectra:
        """Take the rows within a band, rad/s.

        Without coherence or averages the noise is measured by how far rows lie from a smooth line
        through their neighbours. A third difference of their logarithms removes what is quadratic
        in the number of the row. Its variance has half as many degrees of freedom as there are
        rows.

        Parameters
        ----------
        averages : int or None
            Segments that the analyser averaged.
        band : tuple of float
            Rows used, rad/s.

        Returns
        -------
        Spectra
        """
        used = (self.omega >= band[0]) & (self.omega <= band[1])
        omega = self.omega[used]
        impedance = self.impedance[used]
        if self.coherence is not None and averages is not None:
            measured = self.coherence[used]
            coherence = np.clip(measured, _COHERENCE_SLACK, 1.0 - _COHERENCE_SLACK)
            return of_response(omega, impedance, coherence, averages)
        repeats = max(omega.size // 2, 1)
        variance = _noise_between_rows(impedance)
        # The coherence from which `of_response` gets back this variance.
        coherence = np.full(omega.size, 1.0 / (1.0 + repeats * variance))
        return of_response(omega, impedance, coherence, repeats)


def _noise_between_rows(impedance: ComplexArray) -> float:
    """Variance of log Z about what is smooth in the number of the row."""
    phase = np.unwrap(np.angle(impedance))
    log_impedance = np.log(np.abs(impedance)) + 1j * phase
    squares = np.abs(np.diff(log_impedance, 3)) ** 2
    # A resonance is far from smooth: it moves a mean, and hardly the median.
    return float(np.median(squares) / (_MEDIAN_OVER_MEAN * _THIRD_DIFFERENCE))


def read_log(path: str, quantity: str = "impedance") -> TimeLog | Response:
    """Read a CSV of a log.

    Parameters
    ----------
    path : str
        The file. Columns are time (s), force (N), and velocity (m/s) or position (m); or omega
        (rad/s) or frequency (Hz), real and imaginary or magnitude and phase (deg), and coherence
        where there is one. A unit in brackets behind a name is obeyed: `Magnitude (dB)`.
    quantity : str
        What the response is, a key of `QUANTITIES`.

    Returns
    -------
    TimeLog or Response

    Raises
    ------
    UsageError
        A file that cannot be read, a column that is missing or has an unknown unit, a value that
        is no finite number, uneven times, frequencies that do not rise; with the place.
    """
    try:
        table = pd.read_csv(path, sep=None, engine="python", comment="#", encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot be read: {error}.", file=path) from error
    columns = {}
    for title in map(str, table.columns):
        name, unit = _name_and_unit(title)
        columns[name] = _in_si_units(table[title], name, unit, path)
    if "time" in columns:
        return _time_log(columns, path)
    return _response(columns, quantity, path)


def _name_and_unit(title: str) -> tuple[str, str]:
    """Split a column's title, in lower case; the unit is empty where there is none."""
    match = _TITLE.fullmatch(title)
    if match is None:
        name = title.lower()
        return _ALIASES.get(name, name), ""
    name = match["name"].lower()
    unit = match["unit"] or ""
    return _ALIASES.get(name, name), unit.lower()


def _in_si_units(column: pd.Series[Any], name: str, unit: str, path: str) -> Array:
    """Read the numbers of a column; columns of other names may hold anything."""
    values = pd.to_numeric(column, errors="coerce").to_numpy(float)
    if name not in _UNITS:
        return values
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        row = int(wrong[0])
        raise UsageError(
            "must be a finite number.",
            file=path,
            row=row + _FIRST_ROW,
            column=str(column.name),
            value=column.iloc[row],
        )
    if unit == "db":
        return np.asarray(10.0 ** (values / _DECIBELS_PER_DECADE))
    factors = _UNITS[name]
    if unit and factors and unit not in factors:
        raise UsageError(
            f"percept does not know the unit {unit!r}.",
            file=path,
            column=str(column.name),
            hint=f"It knows {', '.join(factors)}.",
        )
    usual = next(iter(factors.values()), 1.0)
    return np.asarray(factors.get(unit, usual) * values)


def _required(columns: dict[str, Array], name: str, path: str) -> Array:
    """Return a column that a log must have."""
    if name not in columns:
        names = ", ".join(columns)
        raise UsageError(f"There is no column {name!r}; there are {names}.", file=path)
    return columns[name]


def _time_log(columns: dict[str, Array], path: str) -> TimeLog:
    """Take force and motion; velocity goes before position."""
    time = columns["time"]
    force = _required(columns, "force", path)
    is_position = "velocity" not in columns
    motion = _required(columns, "position" if is_position else "velocity", path)
    if time.size < 2:
        raise UsageError("The log has fewer than two rows.", file=path)
    step = float((time[-1] - time[0]) / (time.size - 1))
    deviation = np.abs(np.diff(time) - step)
    # Negated, so that a falling clock is uneven too: its step is negative.
    uneven = np.flatnonzero(~(deviation <= _MOST_UNEVEN * step))
    if uneven.size:
        row = int(uneven[0]) + 1
        raise UsageError(
            f"does not lie one step of {step:.6g} s after the row before.",
            file=path,
            row=row + _FIRST_ROW,
            column="time",
            value=float(time[row]),
            hint="Resample the log to even times.",
        )
    return TimeLog(step, force, motion, is_position)


def _response(columns: dict[str, Array], quantity: str, path: str) -> Response:
    """Take a complex response, and make an impedance of it."""
    omega = columns.get("omega")
    if omega is None:
        omega = 2.0 * np.pi * _required(columns, "frequency", path)
    if "real" in columns:
        response = columns["real"] + 1j * _required(columns, "imaginary", path)
    else:
        phase = _required(columns, "phase", path)
        magnitude = _required(columns, "magnitude", path)
        response = magnitude * np.exp(1j * phase)
    step = np.diff(omega, prepend=0.0)
    # Negated, so that a frequency beyond the doubles is refused too.
    falling = np.flatnonzero(~(step > 0.0))
    if falling.size:
        row = int(falling[0])
        raise UsageError(
            "must rise from above zero.",
            file=path,
            row=row + _FIRST_ROW,
            column="frequency",
            value=float(omega[row]),
            hint="Sort the rows and leave out zero frequency.",
        )
    zeros = np.flatnonzero(response == 0.0)
    if zeros.size:
        row = int(zeros[0])
        raise UsageError("The response is zero here.", file=path, row=row + _FIRST_ROW)
    definition = QUANTITIES[quantity]
    force_over_motion = response
    if definition.motion_over_force:
        force_over_motion = 1.0 / response
    impedance = force_over_motion * (1j * omega) ** definition.derivative
    return Response(omega, impedance, columns.get("coherence"))
