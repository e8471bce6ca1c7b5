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
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from reports.benchmark import twins as twin
from reports.benchmark.simulated import DESIGNS, simulated
from reports.benchmark.twins import Levels, Number
from reports.fitted import estimands_of
from reports.page import Page
from reports.studies import Observed, model_of

Array = NDArray[np.float64]

_INTRODUCTION = """\
The worst case of one quantity at one point, against exact arithmetic or 120 digits. What varies
are data sets; subjects; variances in squared units of the response; 1 − correlation; an offset of
all responses; the coefficient of variation of subjects' adjustments; floor(log10(ωT)), which is 1
at Nyquist. In irregular studies one subject lacks an environment. `digits` are decimal, at most 16:
of the value, for log p of 1 + abs(log p), for haptics beyond what the formula's condition costs.
`over promise` is the worst error over the promised one; it is inf where a draw is refused."""
_SAMPLED = """\
Two studies whose scatter is scaled to a coefficient of variation. Their draws lie where the table
above keeps its digits. Half-widths over the coefficient of variation stay the same: no digits and
no draws are missed."""
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
        "denormal": np.asarray(5e-324 * random.integers(1, 1000, _SAMPLE)),
        "huge": 1e308 * random.uniform(-1.0, 1.0, _SAMPLE),
        "300 decades": random.normal(size=_SAMPLE) * 10.0 ** random.integers(-150, 150, _SAMPLE),
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
#: The same of irregular studies, by normal equations: 1e-4 at abs(log p) of 100, which moves the
#: posterior by as much.
_IRREGULAR_PROMISE = 1e-6
_ENVIRONMENTS = 2
_TRIALS = 2
_SUBJECTS = 3
_STUDIES = ("6x3x3", "10x5-irregular")
_ORDINARY = Levels(between=0.2, shared=0.1, trial=0.05, tau=0.1, rest=0.5)
_TINY = Levels(between=1e-6, shared=1e-6, trial=1e-6, tau=1e-6, rest=0.5)
_EXPONENTS = (-28, -20, -12, -4, 0, 4, 12)  # Of ten, of a variance
_VARIATION = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 2e-7)
_USUAL = 0.1  # SD of subjects' trials in simulated studies
Formula: TypeAlias = Callable[[Array, Array, Levels], float]


@dataclass(frozen=True)
class _Case:
    along: str
    at: float
    levels: Levels = _ORDINARY
    subjects: int = _SUBJECTS
    offset: float = 0.0
    scatter: float = 0.3  # SD of responses about their environment's
    irregular: bool = False


def collapsed(response: Array, x: Array, levels: Levels) -> float:
    """Return percept's log density of responses (subjects, environments, trials, parameters)."""
    _, environments, _, size = response.shape
    is_there = np.isfinite(response[..., 0])
    subject, environment, _ = np.nonzero(is_there)
    cells = np.arange(environments)
    model = model_of(Observed(("k", "b"), response[is_there], subject, environment, cells, x))
    named = {
        "sigma": np.full((size, environments, 1), levels.between),
        "sigma_e": np.full((size, environments, 1), levels.trial),
        "sigma_u": np.full((size, 1), levels.shared),
        "tau": np.full((size, 1), levels.tau),
    }
    rests = {}
    for name in ("rho_w", "rho_e", "rho_u"):
        rests[name] = np.full(1, levels.rest)
        named[name] = 1.0 - rests[name]
    scales = model.coordinates.cell_scales(named, rests, model.design)
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
            location = case.offset + 0.1 * rng.standard_normal((_ENVIRONMENTS, 1, 2))
            noise = rng.standard_normal((case.subjects, _ENVIRONMENTS, _TRIALS, 2))
            response = location + case.scatter * noise
            if case.irregular:
                response[0, -1] = np.nan
            exact = twin.exact(response, x, case.levels)
            errors.append(_density_error(formula(response, x, case.levels), exact))
        promise = _IRREGULAR_PROMISE if case.irregular else _DENSITY_PROMISE
        rows.append(digits_row("log density", case.along, case.at, errors, promise))
    return rows


def _cases() -> Iterator[_Case]:
    for case in _regular_cases():
        yield case
        yield replace(case, along=f"{case.along}, irregular", irregular=True)


def _regular_cases() -> Iterator[_Case]:
    for cv in _VARIATION:
        levels = Levels(between=cv, shared=cv, trial=cv, tau=0.1, rest=0.5)
        yield _Case("coefficient of variation", cv, levels, scatter=cv)
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
    page.add("## Sampled studies")
    page.add(_SAMPLED)
    heads = ["study", "coefficient of variation", "passed", "least variance"]
    sampled = [_sampled(name, cv) for name in _STUDIES for cv in _VARIATION]
    page.table([*heads, "least 1 − abs(correlation)", "half-width over CV"], sampled)
    return page


def _sampled(name: str, cv: float) -> list[object]:
    """Fit a study with its scatter scaled, and return a row of what its draws are."""
    study = simulated(DESIGNS[name], 1)
    location = _USUAL * np.random.default_rng(1).standard_normal(study.x.shape)
    response = location[:, study.cell].T + cv / _USUAL * study.response
    estimands = estimands_of(replace(study, response=response))
    model = estimands.model
    run = sample(model, estimands, Settings(tolerance=0.01, seed=1))
    scales = model.scales(run.points.reshape(-1, len(model.names)))
    sds = [values.min() for scale, (_, values) in scales.items() if scale[:3] in ("sig", "tau")]
    sizes = [abs(values).max() for scale, (_, values) in scales.items() if scale[:3] == "rho"]
    least = float(min(sds)) ** 2, float(1.0 - max(sizes))
    return [name, cv, run.gate.passed, *least, float(np.median(run.estimates.scale)) / cv]
