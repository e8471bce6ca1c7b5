"""Subjects for a published table: a study whose t-intervals print as its limits."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import stdtrit

from percept.errors import RefusalError, UsageError
from percept.inference import Moments
from percept.sessions import Sessions
from percept.simulate import Design, correlated_normal, session_table

#: Correlation of one parameter in two environments.
BETWEEN = 0.4
#: Correlation of stiffness and damping in one environment.
CORRELATION = 0.3
# Ten subjects scatter widely about stated correlations; the nearest of many draws misses them by
# little.
_CANDIDATES = 200
# Significant digits of adjusted values: the fewest with which the table's limits come out.
_DIGITS = (6, 10, 15)
# Limits with more digits were not printed: they come from means and SDs.
_PRINTED_DIGITS = 12
# Exponent below which exp underflows to zero.
_UNDERFLOW = 700.0
Array = NDArray[np.float64]
_Rows = tuple[tuple[Decimal, ...], ...]


@dataclass(frozen=True)
class PublishedLimits:
    """Limits of t-intervals as printed, for J environments and P parameters; numbers are (J, P)."""

    environments: tuple[str, ...]
    parameters: tuple[str, ...]
    reference: _Rows
    lower: _Rows
    upper: _Rows
    n: int  # Subjects
    level: float

    @classmethod
    def from_sessions(cls, sessions: Sessions) -> PublishedLimits:
        """Take a summary that `read_sessions` checked, and require what can be reproduced of it.

        Parameters
        ----------
        sessions : Sessions
            A published table.

        Returns
        -------
        PublishedLimits

        Raises
        ------
        UsageError
            No table of limits, a missing row, several n or levels, or limits that were worked out.
        """
        table = sessions.table
        file = sessions.sources[0].name if sessions.sources else None
        if sessions.form != "summary":
            hint = "It needs environment, parameter, reference, lower, upper, n and level."
            raise UsageError("no table of published limits.", file=file, hint=hint)
        for column in ("n", "level"):
            first, *others = dict.fromkeys(table[column])
            if others:
                message = f"all rows must have the same {column}; the first has {first}."
                raise UsageError(message, file=file, column=column, value=str(others[0]))
        printed: dict[str, _Rows] = {}
        for name in ("reference", "lower", "upper"):
            wide = table.pivot(index="environment", columns="parameter", values=name)
            wide = wide.reindex(index=sessions.environments, columns=sessions.parameters)
            # As printed, without the last digits of a double.
            decimals = wide.map(lambda value: Decimal(f"{value:.15g}"))
            printed[name] = tuple(decimals.itertuples(index=False, name=None))
        for j, environment in enumerate(sessions.environments):
            for p, parameter in enumerate(sessions.parameters):
                limits = (printed["lower"][j][p], printed["upper"][j][p])
                _require_printed(*limits, f"{environment}, {parameter}", file)
        return cls(
            environments=sessions.environments,
            parameters=sessions.parameters,
            **printed,
            n=int(table["n"].iloc[0]),
            level=float(table["level"].iloc[0]),
        )

    @property
    def factor(self) -> float:
        """Half-width of the interval in standard deviations, t/√n (Eq. 15)."""
        return float(-stdtrit(self.n - 1, (1 - self.level) / 2) / np.sqrt(self.n))

    @property
    def moments(self) -> Moments:
        """Mean and SD of the subjects behind the limits, (J, P)."""
        lower = np.array(self.lower, dtype=float)
        upper = np.array(self.upper, dtype=float)
        return Moments.from_limits(lower, upper, self.n, level=self.level)


def _require_printed(lower: Decimal, upper: Decimal, where: str, file: str | None) -> None:
    """Refuse limits that no simulated subjects can print as."""
    if lower.is_nan():
        raise UsageError(f"there is no row for {where}, though others have one.", file=file)
    digits = max(len(limit.as_tuple().digits) for limit in (lower, upper))
    if digits > _PRINTED_DIGITS:
        raise UsageError(
            f"{where}: printed limits are needed, and {lower} to {upper} was worked out.",
            file=file,
            hint="percept fit takes means and standard deviations.",
        )
    if lower == upper:
        raise UsageError(f"{where}: the limits {lower} and {upper} must differ.", file=file)


def simulate_like(published: Sessions, *, seed: int, subjects: int | None = None) -> pd.DataFrame:
    """Make a study with the means and standard deviations behind a table of published limits.

    Values are exp(a + c·z) of correlated standard normal scores z. Their coefficient of variation
    rises with c from 0 to √n, so the published one fixes c, and the mean then fixes a.

    Parameters
    ----------
    published : Sessions
        A published table.
    seed : int
        Seed of the scores.
    subjects : int, optional
        Subjects, the table's own n by default.

    Returns
    -------
    DataFrame
        As `session_table` gives it, with one trial per cell.

    Raises
    ------
    UsageError
        The table, the seed or the number of subjects cannot be used.
    RefusalError
        No positive values have these limits.
    """
    limits = PublishedLimits.from_sessions(published)
    count = limits.n if subjects is None else subjects
    if seed < 0:
        raise UsageError("a seed is a whole number, not negative.", key="seed", value=seed)
    if count < 2:
        raise UsageError("at least two subjects are needed.", key="subjects", value=count)
    design = Design.balanced(
        np.array(limits.reference, dtype=float),
        subjects=count,
        parameters=limits.parameters,
        environments=limits.environments,
    )
    environments, parameters = design.references.shape
    z = _scores(np.random.default_rng(seed), (count, environments, parameters))
    moments = limits.moments
    mean = np.asarray(moments.mean)
    sd = np.asarray(moments.sd)
    adjusted = np.empty_like(z)
    for j, p in np.ndindex(environments, parameters):
        where = f"{limits.environments[j]}, {limits.parameters[p]}"
        exact = _match(z[:, j, p], float(mean[j, p]), float(sd[j, p]), where)
        printed = (limits.lower[j][p], limits.upper[j][p])
        adjusted[:, j, p] = _rounded(exact, limits.factor, printed, where)
    return session_table(design, adjusted.reshape(-1, parameters))


def _scores(rng: np.random.Generator, shape: tuple[int, int, int]) -> Array:
    """Draw scores of that shape: of many draws the one nearest the correlations."""
    subjects, environments, parameters = shape
    pairs = np.triu_indices(environments, 1)

    def draw() -> Array:
        common = correlated_normal(rng, (subjects, 1, parameters), CORRELATION)
        own = correlated_normal(rng, shape, CORRELATION)
        return math.sqrt(BETWEEN) * common + math.sqrt(1 - BETWEEN) * own

    def miss(z: Array) -> float:
        """Distance of the average correlations from those stated; a missing one is right."""
        correlations = np.corrcoef(z.reshape(subjects, -1), rowvar=False)
        r = np.reshape(correlations, (environments, parameters) * 2)
        within = CORRELATION
        across = BETWEEN
        if parameters == 2:
            within = float(np.diagonal(r[:, 0, :, 1]).mean())
        if environments > 1:
            across = float(np.mean([r[:, p, :, p][pairs] for p in range(parameters)]))
        return math.hypot(within - CORRELATION, across - BETWEEN)

    return min((draw() for _ in range(_CANDIDATES)), key=miss)


def _match(z: Array, mean: float, sd: float, where: str) -> Array:
    """exp(a + c·z) with the given mean and SD."""
    if mean <= 0:
        message = f"the limits' middle {mean:g} is not positive, so no positive values have it."
        raise RefusalError(f"{where}: {message}")
    # Of n values, all but one of which are zero, the SD is √n means.
    most = math.sqrt(len(z))
    if sd >= most * mean:
        message = f"no {len(z)} positive values have a standard deviation of {sd / mean:.4g} means"
        raise RefusalError(f"{where}: {message}; the most is below {most:.4g}.")
    # The largest is 1: no overflow however steep.
    shape = z - z.max()

    def excess(c: float) -> float:
        values = np.exp(c * shape)
        return float(values.std(ddof=1) / values.mean()) - sd / mean

    # Beyond this slope the smallest value would underflow to zero.
    steepest = _UNDERFLOW / -shape.min()
    if excess(steepest) <= 0:
        raise RefusalError(
            f"{where}: the scores drawn cannot be spread that far.", hint="Try another seed."
        )
    slope = brentq(excess, 0.0, steepest, xtol=1e-14, rtol=1e-14)
    values = np.exp(slope * shape)
    return mean / values.mean() * values


def _rounded(
    exact: Array, factor: float, printed: tuple[Decimal, Decimal], where: str
) -> list[float]:
    """Round values to the fewest digits with which their interval prints as the table's limits."""
    lower, upper = printed
    for digits in _DIGITS:
        values = [float(f"{value:.{digits - 1}e}") for value in exact]
        mean = statistics.fmean(values)
        half_width = factor * statistics.stdev(values)
        if _prints_as(mean - half_width, lower) and _prints_as(mean + half_width, upper):
            return values
    raise RefusalError(
        f"{where}: no values of {_DIGITS[-1]} digits give limits that print as published."
    )


def _prints_as(limit: float, printed: Decimal) -> bool:
    return Decimal(limit).quantize(printed) == printed


def sessions_csv(table: pd.DataFrame) -> str:
    """Write simulated sessions as CSV; equal tables give equal texts.

    Numbers have the fewest digits that read back as the same double.
    """
    text = table.copy()
    for name in table.select_dtypes("float").columns:
        text[name] = [np.format_float_positional(value, trim="-") for value in table[name]]
    return text.to_csv(index=False, lineterminator="\n")
