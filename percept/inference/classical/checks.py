"""Accept a sample only if it is made of finite numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import RefusalError, UsageError


def finite_values(
    values: ArrayLike, *, name: str = "values", allow_empty: bool = False
) -> NDArray[np.float64]:
    """Return `values` as doubles."""
    if np.ma.is_masked(values):
        raise UsageError(
            f"Some of the {name} are masked.", hint="Pass what is not masked: values.compressed()."
        )
    try:
        found: NDArray[Any] = np.asarray(values)
    except ValueError:
        raise UsageError(
            f"The {name} are rows of unequal length.", hint="Pass samples of different size one at a time."
        ) from None
    if found.dtype.kind not in "iuf" and found.size:
        found = _numeric(found, name)
    if found.size == 0 and not allow_empty:
        raise UsageError(f"There are no {name}: the array is empty.")
    doubles = np.asarray(found, dtype=np.float64)
    finite = np.isfinite(doubles)
    if not finite.all():
        where = np.argwhere(~finite)[0]
        place = ", ".join(str(int(index)) for index in where)
        raise UsageError(
            f"The {name} must be finite numbers; the first that is not is at index [{place}].",
            value=float(doubles[tuple(where)]),
            hint="Leave the trial out, or correct it.",
        )
    return doubles


def positive_values(values: ArrayLike, *, name: str = "values") -> NDArray[np.float64]:
    """Return `values` as doubles fit for a logarithm."""
    doubles = finite_values(values, name=name)
    if (doubles <= 0.0).any():
        raise RefusalError(
            f"The lognormal family takes logarithms, and some of the {name} are zero or negative.",
            value=float(doubles[doubles <= 0.0].flat[0]),
            hint='Use family="normal".',
        )
    return doubles


def sample(
    values: ArrayLike, *, axis: int = -1, positive: bool = False, least: int = 2
) -> NDArray[np.float64]:
    """Return samples with their subjects along the last axis."""
    doubles = positive_values(values) if positive else finite_values(values)
    if doubles.ndim == 0:
        raise UsageError("A sample is needed, not a single number.", value=float(doubles))
    if not -doubles.ndim <= axis < doubles.ndim:
        raise UsageError(f"The values have {doubles.ndim} axes; there is no axis {axis}.")
    moved = np.moveaxis(doubles, axis, -1)
    if moved.shape[-1] < least:
        count = moved.shape[-1]
        raise RefusalError(
            f"At least {least} subjects are needed; there {'is' if count == 1 else 'are'} {count}.",
            hint="Check that the axis of subjects is the one meant, or add subjects.",
        )
    return moved


def subject_counts(n: ArrayLike) -> NDArray[np.int64]:
    """Return numbers of subjects as integers."""
    found = finite_values(n, name="numbers of subjects")
    if (found != np.rint(found)).any():
        raise UsageError(
            "A number of subjects must be whole.", value=float(found[found != np.rint(found)].flat[0])
        )
    if (found > np.iinfo(np.int64).max / 2).any():
        raise UsageError("No study has so many subjects.", value=float(found.max()))
    if (found < 2).any():
        raise RefusalError(
            f"At least 2 subjects are needed; there is {int(found.min())}.", hint="Add subjects."
        )
    return found.astype(np.int64)


def fitted(names: str, *arrays: NDArray[Any]) -> tuple[NDArray[np.float64], ...]:
    """Return arrays as doubles of one shape."""
    try:
        shape = np.broadcast_shapes(*(array.shape for array in arrays))
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise UsageError(f"{names} have shapes that do not fit: {shapes}.") from None
    return tuple(np.broadcast_to(np.asarray(array, dtype=np.float64), shape) for array in arrays)


def positive_references(reference: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return reference values that something can be divided by."""
    shown = finite_values(reference, name="references")
    if (shown <= 0.0).any():
        raise RefusalError(
            "A reference of zero or below has no ratio.",
            value=float(shown.min()),
            hint="Leave this parameter of this environment out.",
        )
    try:
        fits = np.broadcast_shapes(shown.shape, shape) == shape
    except ValueError:
        fits = False
    if not fits:
        raise UsageError(f"There are references of shape {shown.shape} for samples of shape {shape}.")
    return shown


def _numeric(found: NDArray[Any], name: str) -> NDArray[np.float64]:
    if found.dtype.kind == "O":  # Decimal, Fraction, pandas' nullable numbers
        try:
            return found.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            pass
    raise UsageError(f"The {name} must be real numbers; their type is {found.dtype}.")
