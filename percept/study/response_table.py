"""A measured device response Z_d(omega) from a CSV."""

from __future__ import annotations

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.haptics import TabulatedDevice

_COLUMNS = ("omega", "real", "imaginary")


def read_response(path: str) -> TabulatedDevice:
    """Read a table of omega (rad/s) and Z_d, real and imaginary (N·s/m)."""
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise UsageError(f"cannot be read: {error}.", file=path) from error
    missing = [name for name in _COLUMNS if name not in table.columns]
    if missing:
        raise UsageError(
            f"the column is missing; there are {', '.join(table.columns)}.", file=path, column=missing[0]
        )
    impedance = np.empty(len(table), dtype=complex)
    try:
        # Part by part: 1j times an infinite number is not a number.
        impedance.real, impedance.imag = table["real"].to_numpy(float), table["imaginary"].to_numpy(float)
        return TabulatedDevice(omega=table["omega"].to_numpy(float), impedance=impedance)
    except UsageError as error:
        error.file = path
        raise
    except ValueError as error:
        raise UsageError(f"holds what is not a number: {error}.", file=path) from error
