"""Digits that means, SDs and the density keep."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from percept.inference import Moments
from reports.benchmark import twins as twin
from reports.benchmark.twins import Levels, Number
from reports.page import Page
from reports.studies import Observed, model_of

Array = NDArray[np.float64]

_INTRODUCTION = """\
The worst case of one quantity at one point, against exact arithmetic or 120 digits. What varies
are data sets; subjects; variances in squared units of the response; 1 − correlation; an offset of
all responses; floor(log10(ωT)), which is 1 at Nyquist. `digits` are decimal, at most 16: of the
value, for log p of 1 + abs(log p), for haptics beyond what the formula's condition costs.
`over promise` is the worst error over the promised one."""
_MOST_DIGITS = 16.0  # A double has no more


@dataclass(frozen=True)
class Digits:
    """The worst case of one quantity at one point, against exact arithmetic or 120 digits."""

    quantity: str
    along: str  # What varies
    at: str | float  # Its value
    cases: int
    digits: float  # Kept in the worst case
    over_promise: float  # Worst error over the promised one: the promise is kept up to 1


def digits_of(error: float) -> float:
    """Return the decimal digits of a relative error, 0 to 16; none of NaN."""
    if math.isnan(error):
        return 0.0
    digits = -math.log10(max(error, 1e-300))
    return min(_MOST_DIGITS, max(0.0, digits))


def digits_row(
    quantity: str, along: str, at: str | float, errors: list[float], promise: float
) -> Digits:
    """Return one row of the table, from the relative errors of its cases."""
    worst = max(errors)
    return Digits(quantity, along, at, len(errors), digits_of(worst), worst / promise)


# Means and SDs

_ULPS = 4  # Promised distance from the correctly rounded value
_SAMPLE = 1000  # Values of a random sample
_NUM_ACC = {2: "1", 3: "1000000", 4: "10000000"}  # Whole part of NIST's sets


def number_accuracy(which: int) -> tuple[Array, float, float]:
    """Return NIST's NumAcc data set 1 to 4, its certified mean and SD."""
    if which == 1:
        return np.array([10000001.0, 10000003.0, 10000002.0]), 10000002.0, 1.0
    whole = _NUM_ACC[which]
    texts = [f"{whole}.2"] + [f"{whole}.1", f"{whole}.3"] * 500
    return np.array([float(text) for text in texts]), float(f"{whole}.2"), 0.1


def moment_digits(*, seed: int = 1) -> list[Digits]:
    """Compare means and SDs with exact rational arithmetic.

    Parameters
    ----------
    seed : int
        Of the random samples.

    Returns
    -------
    list of Digits
        A row for each mean and each SD.
    """
    random = np.random.default_rng(seed)
    samples = {f"NumAcc{which}": number_accuracy(which)[0] for which in range(1, 5)}
    samples |= {
        "offset 1e15": 1e15 + random.normal(size=_SAMPLE),
        "constant 0.1": np.full(_SAMPLE, 0.1),
        "denormal": np.asarray(5e-324 * random.integers(1, 1000, _SAMPLE)),
        "huge": 1e308 * random.uniform(-1.0, 1.0, _SAMPLE),
        "300 decades": random.normal(size=_SAMPLE) * 10.0 ** random.integers(-150, 150, _SAMPLE),
        "1e300, 1, -1e300": np.array([1e300, 1.0, -1e300]),
    }
    rows = []
    for name, values in samples.items():
        moments = Moments.from_values(values)
        rows.append(_moment_row("mean", name, moments.mean, float(_exact_mean(values))))
        rows.append(_moment_row("SD", name, moments.sd, _exact_sd(values)))
    return rows


def _moment_row(quantity: str, name: str, ours: Any, exact: float) -> Digits:
    if exact:
        error = abs(float(ours) - exact) / abs(exact)
        promise = _ULPS * math.ulp(exact) / abs(exact)
    else:
        error = 0.0 if ours == exact else math.inf
        promise = 1.0
    return digits_row(quantity, "data set", name, [error], promise)


def _exact_mean(values: Array) -> Fraction:
    return sum(map(Fraction, values.tolist()), Fraction(0)) / values.size


def _exact_sd(values: Array) -> float:
    """Return the SD, correctly rounded."""
    import mpmath

    mean = _exact_mean(values)
    squares = ((Fraction(value) - mean) ** 2 for value in values.tolist())
    variance = sum(squares, Fraction(0)) / (values.size - 1)
    with mpmath.workdps(60):
        return float(mpmath.sqrt(mpmath.mpf(variance.numerator) / variance.denominator))


# The hierarchical model's density

_DENSITY_PROMISE = 1e-9  # Largest error per unit of 1 + abs(log p)
_ENVIRONMENTS = 2
_TRIALS = 2
_SUBJECTS = 3
_ORDINARY = Levels(between=0.2, shared=0.1, trial=0.05, tau=0.1, rest=0.5)
_TINY = Levels(between=1e-6, shared=1e-6, trial=1e-6, tau=1e-6, rest=0.5)
_EXPONENTS = (-12, -8, -4, 0, 4, 8, 12)  # Of ten, of a variance
Formula: TypeAlias = Callable[[Array, Array, Levels], float]


@dataclass(frozen=True)
class _Case:
    along: str
    at: float
    levels: Levels = _ORDINARY
    subjects: int = _SUBJECTS
    offset: float = 0.0


def collapsed(response: Array, x: Array, levels: Levels) -> float:
    """Return percept's log density of responses (subjects, environments, trials, parameters)."""
    *shape, size = response.shape
    subject, environment, _ = np.indices(shape).reshape(3, -1)
    trials = response.reshape(-1, size)
    model = model_of(Observed(("k", "b"), trials, subject, environment, np.arange(shape[1]), x))
    named = {
        "sigma": np.full((size, shape[1], 1), levels.between),
        "sigma_e": np.full((size, shape[1], 1), levels.trial),
        "sigma_u": np.full((size, 1), levels.shared),
        "tau": np.full((size, 1), levels.tau),
    }
    rests = {}
    for name in ("rho_w", "rho_e", "rho_u"):
        rests[name] = np.full(1, levels.rest)
        named[name] = 1.0 - rests[name]
    scales = model.coordinates.cell_scales(named, rests)
    return float(model.log_likelihood(scales)[0])


def density_digits(
    draws: int = 3, *, seed: int = 1, along: tuple[str, ...] = (), formula: Formula = collapsed
) -> list[Digits]:
    """Compare log densities with 120-digit arithmetic, on random responses.

    Parameters
    ----------
    draws : int
        Studies of each case.
    seed : int
        Of the responses.
    along : tuple of str, optional
        Only cases in which one of these varies.
    formula : callable, optional
        What is compared: from responses, the environments' x and the scales to log p.

    Returns
    -------
    list of Digits
        A row for each case.
    """
    rng = np.random.default_rng(seed)
    x = np.tile(np.linspace(-1.5, 1.5, _ENVIRONMENTS), (2, 1))
    rows = []
    for case in _cases():
        if along and case.along not in along:
            continue
        errors = []
        for _ in range(draws):
            noise = rng.standard_normal((case.subjects, _ENVIRONMENTS, _TRIALS, 2))
            response = case.offset + 0.3 * noise
            exact = twin.exact(response, x, case.levels)
            errors.append(_density_error(formula(response, x, case.levels), exact))
        rows.append(digits_row("log density", case.along, case.at, errors, _DENSITY_PROMISE))
    return rows


def _cases() -> Iterator[_Case]:
    sds = [10.0 ** (exponent / 2) for exponent in _EXPONENTS]
    for sd in sds:
        yield _Case("all variances", sd**2, Levels(sd, sd, sd, sd, 0.5))
    for name in ("between", "shared", "trial", "tau"):
        for sd in sds:
            levels = replace(_TINY, **{name: sd})
            yield _Case(f"variance of {name}, others 1e-12", sd**2, levels)
    for power in range(1, 10):
        rest = 10.0**-power
        yield _Case("1 − correlation", rest, replace(_ORDINARY, rest=rest))
    for subjects in (2, 4):
        yield _Case("subjects", subjects, subjects=subjects)
    for offset in (0.0, 1.0, 1e3, 1e6, 1e9):
        yield _Case("offset", offset, offset=offset)


def _density_error(computed: float, exact: Number) -> float:
    """Return the error over 1 + abs(log p); infinite for NaN."""
    if not math.isfinite(computed):
        return math.inf
    return float(abs(computed - exact) / (1 + abs(exact)))


def page(out: Path, *, cases: int = 2000) -> Page:
    """Count the digits that means, SDs, the density and the haptics formulas keep.

    Parameters
    ----------
    out : Path
        Folder of the page.
    cases : int
        Sets of parameters of the haptics formulas.

    Returns
    -------
    Page
    """
    from reports.benchmark.digits_haptics import haptics_digits

    rows = [*moment_digits(), *density_digits(), *haptics_digits(cases)]
    page = Page("Digits", _INTRODUCTION, right=max(row.over_promise for row in rows) <= 1.0)
    heads = ["quantity", "along", "at", "cases", "digits", "over promise"]
    page.table(heads, [astuple(row) for row in rows])
    return page
