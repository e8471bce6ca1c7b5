"""Subjects for a published table: a study whose t-intervals print as the limits that were published."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import brentq

from percept.errors import RefusalError, UsageError
from percept.sessions import ReadOptions
from percept.simulate.model import Seed, correlated_normal, generator
from percept.simulate.published import PublishedLimits, read_summary
from percept.simulate.tables import session_table

BETWEEN = 0.4
CORRELATION = 0.3
_CANDIDATES = 200


@dataclass(frozen=True)
class Correlations:
    """Correlations of the logarithms of the adjusted values, each an average over equals.

    Parameters
    ----------
    within : float or None
        Between k and b of one environment, averaged over environments; None with one parameter.
    across : float or None
        Of one parameter between two environments, averaged over pairs and parameters; None with one
        environment.
    """

    within: float | None
    across: float | None


def simulate_like(
    summary: pd.DataFrame | PublishedLimits,
    *,
    seed: Seed,
    subjects: int | None = None,
    between: float = BETWEEN,
    correlation: float = CORRELATION,
    digits: int = 6,
) -> pd.DataFrame:
    """Make a study with the means and standard deviations behind a table of published limits.

    Scores z are standard normal, a subject effect and an effect of the subject in one environment:
    z = √between·u + √(1 − between)·w, with k and b correlated alike in both. Ten subjects scatter
    widely about such correlations, so of many draws the one that comes nearest to them is kept.

    An environment's values are exp(a + c·z): positive whatever a and c, and skewed as their SD
    demands. Their coefficient of variation rises with c from 0 to √n, so the published one fixes c,
    and the mean then fixes a.

    Parameters
    ----------
    summary : pandas.DataFrame or PublishedLimits
        The published table: environment, parameter, reference, lower, upper, n, level.
    seed : int, SeedSequence or Generator
        Where the randomness comes from.
    subjects : int, optional
        Number of subjects. Left out, the table's n, and the t-intervals of the result print as the
        table's limits; otherwise its means and standard deviations are kept, and the limits narrow or
        widen with the number.
    between : float, optional
        Correlation of one parameter between environments, in [0, 1]: the subject effect's share of
        the variance of the scores.
    correlation : float, optional
        Correlation of k and b within an environment, in [-1, 1].
    digits : int, optional
        Significant digits of the adjusted values.

    Returns
    -------
    pandas.DataFrame
        One row per subject and environment, as `session_table` describes.

    Raises
    ------
    UsageError
        Options out of range, or a table `PublishedLimits` does not accept.
    RefusalError
        A mean that is not positive, a scatter no positive values can have (SD ≥ √n·mean), or too few
        digits to reproduce the limits.
    """
    published = summary if isinstance(summary, PublishedLimits) else PublishedLimits.from_table(summary)
    count = published.n if subjects is None else subjects
    if count < 2:
        raise UsageError("at least two subjects are needed.", key="subjects", value=count)
    if not 0 <= between <= 1:
        raise UsageError("between must lie in [0, 1].", key="between", value=between)
    if not -1 <= correlation <= 1:
        raise UsageError("a correlation lies in [-1, 1].", key="correlation", value=correlation)
    if not 1 <= digits <= 15:
        raise UsageError("a double holds 1 to 15 significant digits.", key="digits", value=digits)
    design = published.design(count)
    environments, parameters = design.references.shape
    rng = generator(seed)
    z = _scores(rng, (count, environments, parameters), between, correlation)
    adjusted = np.empty_like(z)
    for j, p in np.ndindex(environments, parameters):
        where = f"{published.environments[j]}, {published.parameters[p]}"
        exact = _match(z[:, j, p], float(published.mean[j, p]), float(published.sd[j, p]), where)
        adjusted[:, j, p] = [float(f"{value:.{digits - 1}e}") for value in exact]
        _check(adjusted[:, j, p], published, (j, p), where)
    i, j = np.indices((count, environments)).reshape(2, -1)
    return session_table(design, i, j, np.ones_like(i), adjusted.reshape(-1, parameters))


def simulate_like_csv(
    path: str | os.PathLike[str],
    *,
    seed: Seed,
    subjects: int | None = None,
    between: float = BETWEEN,
    correlation: float = CORRELATION,
    digits: int = 6,
    options: ReadOptions | None = None,
) -> pd.DataFrame:
    """Make a study like the published table in a file; `write_sessions` then writes it.

    Parameters
    ----------
    path : str or path-like
        File of the published table.
    seed, subjects, between, correlation, digits
        As in `simulate_like`.
    options : ReadOptions, optional
        How to read the file.

    Returns
    -------
    pandas.DataFrame
        As `simulate_like` gives it.

    Raises
    ------
    UsageError, RefusalError
        As `read_summary` and `simulate_like` raise them.
    """
    return simulate_like(
        read_summary(path, options=options),
        seed=seed,
        subjects=subjects,
        between=between,
        correlation=correlation,
        digits=digits,
    )


def realised_correlations(table: pd.DataFrame) -> Correlations:
    """Correlations a study has, to be set beside those that were asked for.

    Parameters
    ----------
    table : pandas.DataFrame
        One row per subject and environment, every cell filled, adjusted values positive.

    Returns
    -------
    Correlations
        Averages of Pearson's correlation of the logarithms.

    Raises
    ------
    UsageError
        If a cell is missing, given twice, or not positive.
    """
    parameters = [name for name in ("k_adj", "b_adj") if name in table]
    if table.duplicated(["subject", "environment"]).any():
        raise UsageError("a subject has two rows for one environment.", column="environment")
    wide = table.pivot(index="subject", columns="environment", values=parameters)
    values = wide.to_numpy(dtype=float)
    if not (values > 0).all():
        raise UsageError("every subject needs a positive value in every environment.", column="k_adj, b_adj")
    scores = np.log(values).reshape(len(wide), len(parameters), -1)
    return _correlations(np.swapaxes(scores, 1, 2))


def _correlations(z: NDArray[np.float64]) -> Correlations:
    """Average correlations of scores (subjects, environments, parameters)."""
    _, environments, parameters = z.shape
    r = np.reshape(
        np.corrcoef(z.reshape(len(z), -1), rowvar=False), (environments, parameters, environments, parameters)
    )
    pairs = np.triu_indices(environments, 1)
    return Correlations(
        within=float(np.diagonal(r[:, 0, :, 1]).mean()) if parameters == 2 else None,
        across=float(np.mean([r[:, p, :, p][pairs] for p in range(parameters)]))
        if environments > 1
        else None,
    )


def _scores(
    rng: np.random.Generator, shape: tuple[int, int, int], between: float, correlation: float
) -> NDArray[np.float64]:
    """Of many draws of scores (subjects, environments, parameters), the one nearest the correlations."""
    subjects, _, parameters = shape

    def draw() -> NDArray[np.float64]:
        u = correlated_normal(rng, (subjects, 1, parameters), correlation)
        return math.sqrt(between) * u + math.sqrt(1 - between) * correlated_normal(rng, shape, correlation)

    def miss(z: NDArray[np.float64]) -> float:
        found = _correlations(z)
        within = 0.0 if found.within is None else found.within - correlation
        across = 0.0 if found.across is None else found.across - between
        return math.hypot(within, across)

    return min((draw() for _ in range(_CANDIDATES)), key=miss)


def _match(z: NDArray[np.float64], mean: float, sd: float, where: str) -> NDArray[np.float64]:
    """exp(a + c·z) with the given mean and SD."""
    if mean <= 0:
        raise RefusalError(
            f"{where}: the limits' middle {mean:g} is not positive, so no positive values have it."
        )
    if sd >= math.sqrt(len(z)) * mean:
        raise RefusalError(
            f"{where}: no {len(z)} positive values have a standard deviation of {sd / mean:.4g} means; "
            f"the most is below {math.sqrt(len(z)):.4g}."
        )
    # The largest is 1: no overflow however steep.
    shape = z - z.max()

    def excess(c: float) -> float:
        values = np.exp(c * shape)
        return float(values.std(ddof=1) / values.mean()) - sd / mean

    # Beyond this slope the smallest value would underflow to zero.
    steepest = 700 / -shape.min()
    if excess(steepest) <= 0:
        raise RefusalError(f"{where}: the scores drawn cannot be spread that far.", hint="Try another seed.")
    values = np.exp(brentq(excess, 0.0, steepest, xtol=1e-14, rtol=1e-14) * shape)
    return mean / values.mean() * values


def _check(
    values: NDArray[np.float64], published: PublishedLimits, cell: tuple[int, int], where: str
) -> None:
    """Refuse values whose interval does not print as the table's limits."""
    mean = math.fsum(values) / len(values)
    sd = math.sqrt(math.fsum((values - mean) ** 2) / (len(values) - 1))
    j, p = cell
    for limit, printed in (
        (mean - published.factor * sd, published.lower[j][p]),
        (mean + published.factor * sd, published.upper[j][p]),
    ):
        if Decimal(limit).quantize(printed) != printed:
            raise RefusalError(
                f"{where}: values of so few digits give the limit {limit:.10g}, not the {printed} published.",
                key="digits",
                hint="Ask for more digits.",
            )
