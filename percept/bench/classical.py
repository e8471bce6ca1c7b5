"""Digits the means and SDs keep, and what the classical intervals really cover."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import cycle, islice, product
from math import inf, isfinite, isqrt, log10, nextafter, ulp

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.classical.exact import MomentsAccumulator
from percept.inference.classical.parametric import family_moments
from percept.inference.classical.sample_intervals import prediction_interval, t_interval, tolerance_interval
from percept.inference.classical.trials import subject_means
from percept.inference.intervals import Family

_CHUNK = 100_000


@dataclass(frozen=True)
class Digits:
    """Digits kept of one quantity of one data set."""

    name: str  # Data set
    quantity: str  # Sample mean or SD
    kept: float | None  # Decimal digits that agree with the certified value
    possible: float | None
    ulps: float  # Distance from the correctly rounded value on those doubles, in units in the last place
    direct: float


@dataclass(frozen=True)
class Coverage:
    """How often an interval held what its sentence says."""

    statement: str  # What was checked
    family: Family  # Of population and interval
    n: int  # Subjects per study
    cv: float  # Coefficient of variation of the population
    stated: float  # Level (or confidence) the interval states
    theory: float  # What it should hold: `stated`, but for the misreading
    held: float  # Share of the simulated studies in which it did
    error: float  # Binomial standard error of `held`


def number_accuracy(which: int) -> tuple[NDArray[np.float64], float, float]:
    """Return NIST's NumAcc data set 1 to 4, its certified mean and SD."""
    if which == 1:
        return np.array([10000001.0, 10000003.0, 10000002.0]), 10000002.0, 1.0
    whole = {2: "1", 3: "1000000", 4: "10000000"}[which]
    texts = [f"{whole}.2", *islice(cycle((f"{whole}.1", f"{whole}.3")), 1000)]
    return np.array([float(text) for text in texts]), float(f"{whole}.2"), 0.1


def small_large(which: int) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
    """Return NIST's one-way data set SmLs01 to SmLs09, and the certified SD within its nine treatments."""
    whole = ("1", "1000000", "1000000000000")[(which - 1) // 3]
    replicates = (21, 201, 2001)[(which - 1) % 3]
    texts = []
    for tenths in (4, 3, 5, 3, 5, 3, 5, 3, 5):
        sides = (f"{whole}.{tenths - 1}", f"{whole}.{tenths + 1}")
        texts += [f"{whole}.{tenths}", *islice(cycle(sides), replicates - 1)]
    return np.array([float(text) for text in texts]), np.repeat(np.arange(9), replicates), 0.1


def digits_kept(*, long: int = 10_000_000, seed: int = 1) -> list[Digits]:
    """Compare means and SDs with certified values and with exact rational arithmetic."""
    rows = []
    for which in range(1, 5):
        values, mean, sd = number_accuracy(which)
        rows += _of_sample(f"NumAcc{which}", values, mean, sd)
    for which in range(1, 10):
        values, treatment, sd = small_large(which)
        computed = subject_means(values, treatment).trial_sd
        assert computed is not None
        groups = [values[treatment == index] for index in range(9)]
        within = sum((_squares_about_mean(group) for group in groups), Fraction(0))
        exact = within / (values.size - 9)
        direct = _textbook(groups)[1]
        rows.append(_digits(f"SmLs0{which}", "sd", computed, _root(exact), sd, direct))
    random = np.random.default_rng(seed)
    hard: dict[str, NDArray[np.float64]] = {
        "offset 1e15": 1e15 + random.normal(size=1000),
        "constant 0.1": np.full(1000, 0.1),
        "denormal": np.asarray(5e-324 * random.integers(1, 1000, 1000)),
        "huge": 1e308 * random.uniform(-1.0, 1.0, 1000),
        "300 decades": random.normal(size=1000) * 10.0 ** random.integers(-150, 150, 1000),
        "1e300, 1, -1e300": np.array([1e300, 1.0, -1e300]),
    }
    for name, sample in hard.items():
        rows += _of_sample(name, sample)
    # the deviations are whole numbers of 1/8, the spacing of doubles at 10¹⁵: so the answer is known exactly
    eighths = random.integers(-40, 41, long)
    sums = MomentsAccumulator()
    sample = 1e15 + eighths / 8.0
    for start in range(0, long, _CHUNK):
        sums.update(sample[start : start + _CHUNK])
    total, squares = int(eighths.sum()), int((eighths**2).sum())
    mean_exact = Fraction(10**15) + Fraction(total, 8 * long)
    variance = Fraction(long * squares - total * total, 64 * long * (long - 1))
    name = f"offset 1e15, {long:.0e} values in chunks"
    direct_mean, direct_sd = _textbook([sample])
    rows.append(_digits(name, "mean", sums.mean, float(mean_exact), None, direct_mean))
    rows.append(_digits(name, "sd", sums.sd, _root(variance), None, direct_sd))
    return rows


def coverage(
    *,
    studies: int = 100_000,
    sizes: tuple[int, ...] = (3, 5, 10, 30),
    cvs: tuple[float, ...] = (0.05, 0.2, 0.5),
    level: float = 0.99,
    confidence: float = 0.95,
    seed: int = 1,
) -> list[Coverage]:
    """Simulate studies and count how often each interval holds what it says."""
    rows = []
    streams = np.random.SeedSequence(seed).spawn(2 * len(sizes) * len(cvs))
    families: tuple[Family, ...] = ("normal", "lognormal")
    for (family, n, cv), stream in zip(product(families, sizes, cvs), streams, strict=True):
        random = np.random.default_rng(stream)
        log = family == "lognormal"
        centre, sigma = (0.0, float(np.sqrt(np.log1p(cv**2)))) if log else (1.0, cv)
        drawn = random.normal(centre, sigma, (studies, n + 1))
        values = np.exp(drawn) if log else drawn
        users, newcomer, typical = values[:, :n], values[:, n], 1.0
        moments, _ = family_moments(users, family)
        mean = t_interval(moments, level=level, family=family)
        user = prediction_interval(moments, level=level, family=family)
        share = tolerance_interval(moments, level=level, confidence=confidence, family=family)
        lower, upper = (np.log(share.lower), np.log(share.upper)) if log else (share.lower, share.upper)
        content = special.ndtr((upper - centre) / sigma) - special.ndtr((lower - centre) / sigma)
        expected = float(np.max(mean.expected_share)) if mean.expected_share is not None else level
        for statement, stated, theory, held in (
            ("mean", level, level, (mean.lower <= typical) & (typical <= mean.upper)),
            ("user", level, level, (user.lower <= newcomer) & (newcomer <= user.upper)),
            ("share", confidence, confidence, content >= level),
            ("mean read as users", level, expected, (mean.lower <= newcomer) & (newcomer <= mean.upper)),
        ):
            error = float(np.sqrt(theory * (1.0 - theory) / studies))
            rows.append(Coverage(statement, family, n, cv, stated, theory, float(np.mean(held)), error))
    return rows


def _of_sample(
    name: str, values: NDArray[np.float64], mean: float | None = None, sd: float | None = None
) -> list[Digits]:
    sums = MomentsAccumulator()
    sums.update(values)
    fractions = [Fraction(value) for value in values.tolist()]
    exact_mean = float(sum(fractions, Fraction(0)) / len(fractions))
    exact_sd = _root(_squares_about_mean(values) / (len(fractions) - 1))
    direct_mean, direct_sd = _textbook([values])
    return [
        _digits(name, "mean", sums.mean, exact_mean, mean, direct_mean),
        _digits(name, "sd", sums.sd, exact_sd, sd, direct_sd),
    ]


def _textbook(groups: list[NDArray[np.float64]]) -> tuple[float, float]:
    """Mean and SD about the groups' means, from sums of values and of their squares in doubles."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = np.array([group.sum() for group in groups])
        squares = np.array([(group * group).sum() for group in groups])
        size = np.array([group.size for group in groups])
        left = (squares - total * total / size).sum() / (size.sum() - len(groups))
        return float(total.sum() / size.sum()), float(np.sqrt(left))


def _squares_about_mean(values: NDArray[np.float64]) -> Fraction:
    fractions = [Fraction(value) for value in values.tolist()]
    mean = sum(fractions, Fraction(0)) / len(fractions)
    return sum(((value - mean) ** 2 for value in fractions), Fraction(0))


def _root(square: Fraction) -> float:
    """Return the double nearest to a root, by comparing squares."""
    if square == 0:
        return 0.0
    shift = max(0, 2 * (200 + square.denominator.bit_length() - square.numerator.bit_length()))
    near = Fraction(isqrt((square.numerator << shift) // square.denominator), 1 << shift // 2)
    guess = float(near)
    candidates = (nextafter(guess, 0.0), guess, nextafter(guess, inf))
    return min(candidates, key=lambda candidate: abs(Fraction(candidate) - near))


def _digits(
    name: str, quantity: str, computed: float, exact: float, certified: float | None, direct: float
) -> Digits:
    return Digits(
        name,
        quantity,
        None if certified is None else _agreement(computed, certified),
        None if certified is None else _agreement(exact, certified),
        abs(computed - exact) / ulp(exact),
        max(0.0, _agreement(direct, exact)) if isfinite(direct) else 0.0,
    )


def _agreement(value: float, certified: float) -> float:
    """Return the logarithm of the relative error, as digits, at most 16."""
    if value == certified:
        return 16.0
    if certified == 0.0:
        return 0.0
    return min(16.0, -log10(abs(value - certified) / abs(certified)))
