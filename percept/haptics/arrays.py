"""Checks on numbers coming in, and arithmetic that keeps true limits where a factor is infinite."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError

FloatArray: TypeAlias = NDArray[np.float64]
ComplexArray: TypeAlias = NDArray[np.complex128]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.intp]
Scalars: TypeAlias = float | FloatArray

# Beyond this no device exists, and products of a few parameters would leave the range of a double.
LARGEST = 1e100
# s, for the same reason; no device samples as fast.
_SHORTEST_PERIOD = 1e-100


def real_array(value: ArrayLike, name: str, unit: str) -> FloatArray:
    """Return `value` as finite doubles; anything else is a `UsageError` with `name` and `unit`."""
    return _finite(value, name, unit, "real", "iuf").astype(np.float64)


def complex_array(value: ArrayLike, name: str, unit: str) -> ComplexArray:
    """Return `value` as finite complex doubles (see `real_array`)."""
    return _finite(value, name, unit, "complex", "iufc").astype(np.complex128)


def _finite(value: ArrayLike, name: str, unit: str, what: str, kinds: str) -> NDArray[Any]:
    """Refuse what is masked, ragged, not of NumPy's `kinds` of type, not finite or too large."""
    if np.ma.is_masked(value):
        raise UsageError(
            f"{name} has masked elements.", hint="Drop the points that were not measured."
        )
    try:
        array = np.asarray(value)
    except ValueError:
        raise UsageError(f"{name} has rows of unequal length.") from None
    if array.dtype.kind not in kinds:
        raise UsageError(
            f"{name} must be {what} numbers in {unit}, not {array.dtype}.", value=value
        )
    bad = ~(np.abs(array) <= LARGEST)
    if bad.any():
        raise UsageError(
            f"{name} must be finite and at most {LARGEST:g} {unit} in magnitude.",
            value=array[bad][0].item(),
            hint="Look for a missing value (NaN) or a wrong unit.",
        )
    return array


def nonnegative_array(value: ArrayLike, name: str, unit: str) -> FloatArray:
    """Return `value` as finite, nonnegative doubles (see `real_array`)."""
    array = real_array(value, name, unit)
    if (array < 0).any():
        raise UsageError(
            f"{name} must not be negative.",
            value=float(array[array < 0][0]),
            hint=f"Give it in {unit}, zero or more.",
        )
    return array


def checked_period(period: float) -> float:
    """Return the sampling period T, s, as a float; anything but one positive number is refused."""
    value = real_array(period, "period", "s")
    if value.ndim or not value >= _SHORTEST_PERIOD:
        raise UsageError(
            "period must be one positive number of seconds.",
            value=period,
            hint=f"Give the sampling period, {_SHORTEST_PERIOD:g} to {LARGEST:g} s.",
        )
    return float(value)


def ordered_limits(
    limits: tuple[ArrayLike, ArrayLike], name: str, unit: str
) -> tuple[FloatArray, FloatArray]:
    """Return (low, high) as finite doubles with low <= high; either may be negative."""
    try:
        low, high = limits
    except (TypeError, ValueError):
        raise UsageError(
            f"limits of {name} must be a pair (low, high) in {unit}.", value=limits
        ) from None
    low = real_array(low, f"lower limit of {name}", unit)
    high = real_array(high, f"upper limit of {name}", unit)
    if np.any(low > high):
        raise UsageError(
            f"lower limit of {name} is above its upper limit.", hint="Give (low, high)."
        )
    return low, high


def stored(array: FloatArray) -> Scalars:
    """Return a float for one number, else a read-only copy: what frozen records keep."""
    if array.ndim == 0:
        return float(array)
    kept = array.copy()
    kept.flags.writeable = False
    return kept


def one_of(value: str, name: str, choices: tuple[str, ...]) -> str:
    """Return `value` if it is one of `choices`."""
    if value not in choices:
        raise UsageError(f"{name} must be one of {', '.join(map(repr, choices))}.", value=value)
    return value


def times(parameter: ArrayLike, factor: ArrayLike) -> FloatArray:
    """Multiply, with 0·inf = 0: a spring or mass of zero is absent, whatever its factor."""
    with np.errstate(invalid="ignore"):
        product = np.multiply(parameter, factor)
    if np.isfinite(product).all():
        return product
    return np.where(np.isnan(product), 0.0, product)


def ratio(numerator: ArrayLike, denominator: ArrayLike, *, empty: ArrayLike) -> FloatArray:
    """Divide, with x/0 = inf of x's sign, and `empty` for 0/0 and inf/inf; NaN stays NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient = np.divide(numerator, denominator)
    given = ~np.isnan(numerator) & ~np.isnan(denominator)
    return np.where(np.isnan(quotient) & given, empty, quotient)


def complex_from(real: ArrayLike, imaginary: ArrayLike) -> ComplexArray:
    """Join two parts, of shapes that broadcast; real + 1j·imaginary makes NaN of infinite ones."""
    real, imaginary = np.broadcast_arrays(real, imaginary)
    joined = np.empty(real.shape, dtype=np.complex128)
    joined.real = real
    joined.imag = imaginary
    return joined[()]
