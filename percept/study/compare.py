"""Two studies, groups of subjects or devices: the same intervals, and their difference."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError, UsageError, counted
from percept.html import NotebookRecord
from percept.inference.classical.contrasts import group_contrast, group_spread_ratio
from percept.results import Boundary
from percept.sessions import Sessions
from percept.sessions.quantities import trial_columns
from percept.sessions.records import SUMMARY_COLUMNS
from percept.study.basics import Array, Stream, generator
from percept.study.conditions import refuse_gaps

if TYPE_CHECKING:
    from percept.study.fit import Fit
    from percept.study.study import Study


#: Draws of either posterior that are compared; more would not change two digits.
_DRAWS = 8192
#: Turns in which each draw of one posterior meets another draw of the other.
_TURNS = 16
#: Subjects named in a message; of more a sentence would be unreadable.
_MOST_NAMED = 5
_SAME = (
    "A and B are the same sessions: the table of their users, whose intervals assume two samples of"
    " different people, is left out."
)
_CURVE_LABELS = ("environment", "kind", "method", "family")
#: Frequencies that curves are compared at, some 80 a decade over the usual range.
_POINTS = 241
#: Fraction of the upper limit that a lower one counts as: zero has no logarithm.
_FLOOR = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class PairComparison(NotebookRecord):
    """Study B against study A."""

    #: Both studies' limits per environment, parameter, kind, method, family and joint, and the
    #: widths' ratio.
    intervals: pd.DataFrame
    #: Average users of B against A (ratio under the lognormal family, difference in its unit under
    #: the normal), and the ratio of the spreads, with limits.
    differences: pd.DataFrame
    #: Mean of abs(log(B/A)) of the limits of exact envelopes over log omega, log(B/A) where it is
    #: largest in size, and that omega, rad/s.
    curves: pd.DataFrame
    notes: tuple[str, ...] = ()  #: Why there are no differences, and what they take for granted


def split_by(sessions: Sessions, column: str) -> dict[str, Sessions]:
    """Split a study by a column of the sessions, such as a group of subjects."""
    refuse_gaps(sessions, column)
    return {
        str(value): dataclasses.replace(sessions, table=rows)
        for value, rows in sessions.table.groupby(column, sort=False)
    }


def within_subjects(sessions: Sessions, column: str) -> bool:
    """Whether some subjects are in several groups and can be paired; refuse where none can."""
    refuse_gaps(sessions, column)
    cells = sessions.table.groupby(["subject", "environment"], sort=False)[column].nunique()
    groups = sessions.table.groupby("subject", sort=False)[column].nunique()
    shared = [str(subject) for subject in groups.index[groups > 1]]
    if shared and (cells > 1).sum() == 0:
        raise RefusalError(
            f"{_counted(shared)} in more than one group, and no environment was adjusted in two"
            " groups.",
            column=column,
            hint=(
                "Conditions are compared at references that they share: name environments by"
                " reference."
            ),
        )
    return bool(shared)


def compare_studies(first: Study, second: Study) -> PairComparison:
    """Compare two studies over the environments and parameters that both have.

    Parameters
    ----------
    first, second : Study
        A and B, of one family and level, and of different people or under different scenes.

    Returns
    -------
    PairComparison

    Raises
    ------
    UsageError
        Another family or level.
    RefusalError
        No environment in common, the same people in both, or nothing that differs.
    """
    for name in ("family", "level"):
        a = getattr(first.scene.inference, name)
        b = getattr(second.scene.inference, name)
        if a != b:
            raise UsageError(
                f"the two studies are analysed with a {name} of {a} and {b}.",
                key=f"inference.{name}",
            )
    if not set(first.data.environments) & set(second.data.environments):
        raise RefusalError("the two studies have no environment in common, by name.")
    same = _same_sessions(first.sessions, second.sessions)
    if same and first.scene == second.scene:
        raise RefusalError(
            "A and B are the same sessions under the same scene: there is nothing to compare.",
            hint="Give the sessions of other people, or another scene.",
        )
    notes = [_SAME] if same else list(_in_common(first.sessions, second.sessions))
    notes += _left_out(first.data.environments, second.data.environments)
    notes += _left_out(first.data.parameters, second.data.parameters)
    keys = ["environment", "parameter", "kind", "method", "family", "joint"]
    columns = [*keys, "lower", "upper"]
    intervals = first.intervals[columns].merge(
        second.intervals[columns], on=keys, suffixes=("_a", "_b")
    )
    width_a = intervals["upper_a"] - intervals["lower_a"]
    width_b = intervals["upper_b"] - intervals["lower_b"]
    intervals["width_ratio"] = width_b / width_a
    differences = [] if same else [*_classical(first, second), *_bayesian(first, second)]
    notes += _without_difference(first, second, differences)
    curves = pd.DataFrame(_gaps(first, second))
    return PairComparison(intervals, pd.DataFrame(differences), curves, tuple(notes))


def _left_out(of_a: Sequence[str], of_b: Sequence[str]) -> Iterator[str]:
    """Name the environments, or parameters, that one study has alone."""
    for label, own, other in (("A", of_a, of_b), ("B", of_b, of_a)):
        alone = [name for name in own if name not in other]
        if alone:
            yield f"Only {label} has {', '.join(alone)}: left out."


def _without_difference(
    first: Study, second: Study, differences: Sequence[dict[str, object]]
) -> Iterator[str]:
    """Name the environments that both studies have and of which a method gives no difference."""
    environments = [name for name in first.data.environments if name in second.data.environments]
    parameters = [name for name in first.data.parameters if name in second.data.parameters]
    for method in dict.fromkeys(row["method"] for row in differences):
        known = {
            (row["parameter"], row["environment"]) for row in differences if row["method"] == method
        }
        for parameter in parameters:
            lacking = [name for name in environments if (parameter, name) not in known]
            if lacking:
                where = ", ".join(lacking)
                yield (
                    f"No {method} difference of {parameter} in {where}: in A or B it has no"
                    f" interval of the {first.scene.inference.family} family."
                )


def _gaps(first: Study, second: Study) -> Iterator[dict[str, object]]:
    """How far the exact envelopes of B lie from A's, over the frequencies that both study."""
    a_low, a_high = first.data.within
    b_low, b_high = second.data.within
    lower = max(a_low, b_low)
    upper = min(a_high, b_high)
    if not lower < upper:
        return
    omega = np.geomspace(lower, upper, _POINTS)
    envelopes_a = _envelopes(first, omega)
    envelopes_b = _envelopes(second, omega)
    for key, of_a in envelopes_a.items():
        of_b = envelopes_b.get(key)
        if of_b is None:
            continue
        row: dict[str, object] = dict(zip(_CURVE_LABELS, key, strict=True))
        for side in ("lower", "upper"):
            a = np.maximum(getattr(of_a, side), _FLOOR * of_a.upper)
            b = np.maximum(getattr(of_b, side), _FLOOR * of_b.upper)
            log_ratio = np.log(b / a)
            distance = np.abs(log_ratio)
            worst = distance.argmax()
            row[f"area_{side}"] = float(distance.mean())
            row[f"largest_{side}"] = float(log_ratio[worst])
            row[f"omega_{side}"] = float(omega[worst])
        yield row


def _envelopes(study: Study, omega: Array) -> dict[tuple[str, ...], Boundary]:
    """Return a study's exact envelopes at frequencies (M,), rad/s, by what tells curves apart."""
    envelopes = {}
    for boundary in study.boundaries_at(omega, joints=("marginal",)):
        if boundary.shape == "envelope":
            key = tuple(getattr(boundary, name) for name in _CURVE_LABELS)
            envelopes[key] = boundary
    return envelopes


def _same_sessions(first: Sessions, second: Sessions) -> bool:
    if first.form != second.form or first.quantities != second.quantities:
        return False
    columns: tuple[str, ...] = SUMMARY_COLUMNS
    if first.form == "trials":
        columns = trial_columns(first.quantities)
    return first.table[[*columns]].equals(second.table[[*columns]])


def _in_common(first: Sessions, second: Sessions) -> Iterator[str]:
    """Note subjects of the same name; refuse them where the studies share a file."""
    shared = [subject for subject in first.subjects if subject in set(second.subjects)]
    contents = {source.sha256 for source in second.sources}
    files = [source.name for source in first.sources if source.sha256 in contents]
    if shared and files:
        raise RefusalError(
            f"{_counted(shared)} in both studies, and intervals of two samples need different"
            " people.",
            file=files[0],
            hint="Keep each subject in one of the two: [sessions] only, in a scene, chooses rows.",
        )
    if shared:
        yield (
            f"{_counted(shared)} in both studies by name, and taken for different people: if they"
            " are the same, the intervals of the differences do not hold."
        )


def _counted(subjects: Sequence[str]) -> str:
    named = list(subjects[:_MOST_NAMED])
    if len(subjects) > _MOST_NAMED:
        named.append("…")
    verb = "is" if len(subjects) == 1 else "are"
    return f"{counted(len(subjects), 'subject')} ({', '.join(named)}) {verb}"


def _classical(first: Study, second: Study) -> Iterator[dict[str, object]]:
    """Welch's interval of the difference of means, and the F interval of the ratio of SDs."""
    asked = first.scene.inference
    if "bayesian" in (asked.method, second.scene.inference.method):
        return
    moments_a = first.data.moments(asked.family)
    moments_b = second.data.moments(asked.family)
    for cell, a in moments_a.items():
        if cell in moments_b:
            b = moments_b[cell]
            means = group_contrast(a, b, level=asked.level)
            spread = group_spread_ratio(a, b, level=asked.level)
            ends = [means.lower, means.estimate, means.upper]
            ratios = [spread.lower, spread.estimate, spread.upper]
            yield _row(cell, "classical", asked.family, ends, None, ratios)


def _bayesian(first: Study, second: Study) -> Iterator[dict[str, object]]:
    """Root of the mixture of differences of conditional normals."""
    fit_a = first.fit
    fit_b = second.fit
    if fit_a is None or fit_b is None or not (fit_a.passed and fit_b.passed):
        return
    from percept.inference.sampling.endpoints import mixture_quantile

    asked = first.scene.inference
    rng = generator(asked.seed, Stream.PAIRS)
    tail = 0.5 * (1.0 - asked.level)
    draws_a = _draws(fit_a, rng)
    draws_b = _draws(fit_b, rng)
    count = min(len(draws_a.mean), len(draws_b.mean))
    # The posteriors are independent, so each pair of their draws is a draw of both: pairing each
    # draw with several others takes a third to two thirds of the error from quantiles of ratios.
    turns = rng.integers(count, size=_TURNS)
    for cell, column_a in fit_a.column.items():
        column_b = fit_b.column.get(cell)
        if column_b is None:
            continue
        a = draws_a.turned(column_a, count, np.zeros_like(turns))
        b = draws_b.turned(column_b, count, turns)
        mean = (b.mean - a.mean)[:, None]
        sd = np.hypot(a.sd, b.sd)[:, None]
        lower, _ = mixture_quantile(mean, sd, tail, upper=False)
        upper, _ = mixture_quantile(mean, sd, tail, upper=True)
        ends = [float(lower[0]), float(mean.mean()), float(upper[0])]
        ratio = b.spread / a.spread
        spread = np.quantile(ratio, [tail, 0.5, 1.0 - tail]).tolist()
        above = float(special.ndtr(mean / sd).mean())
        yield _row(cell, "bayesian", asked.family, ends, above, spread)


@dataclasses.dataclass(frozen=True)
class _Draws:
    """Draws of populations on the family's scale, in units or logarithms, (S, C) or (S,)."""

    mean: Array
    sd: Array  # Of the mean, given the scales
    spread: Array  # SD between users

    def turned(self, column: int, count: int, turns: NDArray[np.int64]) -> _Draws:
        """Return the first draws of a cell, rolled on by each turn."""

        def rolled(values: Array) -> Array:
            return np.concatenate([np.roll(values[:count, column], turn) for turn in turns])

        return _Draws(rolled(self.mean), rolled(self.sd), rolled(self.spread))


def _draws(fit: Fit, rng: np.random.Generator) -> _Draws:
    """Draw from a fit's posterior, without replacement."""
    chosen = rng.permutation(len(fit.moments.mean))[:_DRAWS]
    scale = fit.scale
    origin = np.log(scale.origin) if scale.log else scale.origin
    return _Draws(
        scale.unit * fit.moments.mean[chosen] + origin,
        scale.unit * fit.moments.sd[chosen],
        scale.unit * fit.moments.population_sd[chosen],
    )


def _row(
    cell: tuple[str, str],
    method: str,
    family: str,
    ends: Sequence[float],
    above: float | None,
    spread: Sequence[float],
) -> dict[str, object]:
    """Make a row: lower, value and upper of the difference of averages and the ratio of spreads."""
    lower, value, upper = np.exp(ends).tolist() if family == "lognormal" else ends
    return {
        "environment": cell[1],
        "parameter": cell[0],
        "method": method,
        "family": family,
        "lower": float(lower),
        "value": float(value),
        "upper": float(upper),
        "probability_above": above,
        "spread_lower": float(spread[0]),
        "spread_value": float(spread[1]),
        "spread_upper": float(spread[2]),
    }
