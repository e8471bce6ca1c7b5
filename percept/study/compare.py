"""Two studies, groups of subjects or devices side by side: the same intervals, and their difference."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import special

from percept.errors import RefusalError, UsageError, counted
from percept.html import NotebookRecord
from percept.sessions import Sessions
from percept.sessions.quantities import trial_columns
from percept.sessions.read import refuse_gaps
from percept.sessions.records import SUMMARY_COLUMNS
from percept.study.basics import Array, Stream, generator
from percept.study.intervals import cell_moments, known_moments

if TYPE_CHECKING:
    from percept.study.fit import Fit
    from percept.study.study import Study

__all__ = ["PairComparison", "compare_studies", "split_by", "within_subjects"]

#: Draws of either posterior, and turns in which each draw of one meets another draw of the other.
_DRAWS, _TURNS = 8192, 16
_MOST_NAMED = 5
_SAME = (
    "A and B are the same sessions: the table of their users, whose intervals assume two samples of"
    " different people, is left out."
)
_CURVE_LABELS = ("environment", "kind", "method", "family")
#: Frequencies that curves are compared at; and the fraction of the upper limit that a lower one
#: counts as.
_POINTS, _FLOOR = 241, 1e-6


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
    """Whether some subjects are in more than one group, and can be paired; refuse where none can."""
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
        a, b = (getattr(study.scene.inference, name) for study in (first, second))
        if a != b:
            raise UsageError(
                f"the two studies are analysed with a {name} of {a} and {b}.",
                key=f"inference.{name}",
            )
    if not set(first.environments) & set(second.environments):
        raise RefusalError("the two studies have no environment in common, by name.")
    same = _same_sessions(first.sessions, second.sessions)
    if same and first.scene == second.scene:
        raise RefusalError(
            "A and B are the same sessions under the same scene: there is nothing to compare.",
            hint="Give the sessions of other people, or another scene.",
        )
    notes = [_SAME] if same else list(_in_common(first.sessions, second.sessions))
    for what in ("environments", "parameters"):
        a, b = (getattr(study, what) for study in (first, second))
        for label, own, other in (("A", a, b), ("B", b, a)):
            if alone := [name for name in own if name not in other]:
                notes.append(f"Only {label} has {', '.join(alone)}: left out.")
    keys = ["environment", "parameter", "kind", "method", "family", "joint"]
    a, b = (study.intervals[[*keys, "lower", "upper"]] for study in (first, second))
    intervals = a.merge(b, on=keys, suffixes=("_a", "_b"))
    widths = [intervals[f"upper_{side}"] - intervals[f"lower_{side}"] for side in ("a", "b")]
    intervals["width_ratio"] = widths[1] / widths[0]
    differences = [] if same else [*_classical(first, second), *_bayesian(first, second)]
    curves = pd.DataFrame(_gaps(first, second))
    return PairComparison(intervals, pd.DataFrame(differences), curves, tuple(notes))


def _gaps(first: Study, second: Study) -> Iterator[dict[str, object]]:
    """How far the exact envelopes of B lie from A's, over the frequencies that both study."""
    (a_low, a_high), (b_low, b_high) = (study.parts.within for study in (first, second))
    lower, upper = max(a_low, b_low), min(a_high, b_high)
    if not lower < upper:
        return
    omega = np.geomspace(lower, upper, _POINTS)
    of_a, of_b = (
        {
            tuple(getattr(boundary, name) for name in _CURVE_LABELS): boundary
            for boundary in study.boundaries_at(omega, joints=("marginal",))
            if boundary.shape == "envelope"
        }
        for study in (first, second)
    )
    for key in (key for key in of_a if key in of_b):
        row: dict[str, object] = dict(zip(_CURVE_LABELS, key, strict=True))
        for side in ("lower", "upper"):
            a, b = (
                np.maximum(getattr(of, side), _FLOOR * of.upper) for of in (of_a[key], of_b[key])
            )
            ratio = np.log(b / a)
            worst = int(np.abs(ratio).argmax())
            row[f"area_{side}"] = float(np.abs(ratio).mean())
            row[f"largest_{side}"], row[f"omega_{side}"] = float(ratio[worst]), float(omega[worst])
        yield row


def _same_sessions(first: Sessions, second: Sessions) -> bool:
    if first.form != second.form or first.quantities != second.quantities:
        return False
    columns = list(trial_columns(first.quantities) if first.form == "trials" else SUMMARY_COLUMNS)
    return first.table[columns].equals(second.table[columns])


def _in_common(first: Sessions, second: Sessions) -> Iterator[str]:
    """Note subjects named alike; refuse them where the studies share a file and they are the same people."""
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
    named = ", ".join([*subjects[:_MOST_NAMED], *["…"] * (len(subjects) > _MOST_NAMED)])
    return f"{counted(len(subjects), 'subject')} ({named}) {'is' if len(subjects) == 1 else 'are'}"


def _classical(first: Study, second: Study) -> Iterator[dict[str, object]]:
    """Welch's interval of the difference of means, and the F interval of the ratio of SDs."""
    asked = first.scene.inference
    if "bayesian" in (asked.method, second.scene.inference.method):
        return
    tail = 0.5 * (1.0 - asked.level)
    of_a, of_b = (
        known_moments(cell_moments(one.sessions, one.parameters, asked.family), asked.family)
        for one in (first, second)
    )
    for cell in of_a:
        if cell not in of_b:
            continue
        mean, sd, n = (
            np.array([float(getattr(moments[cell], name)) for moments in (of_a, of_b)])
            for name in ("mean", "sd", "n")
        )
        squared = sd**2 / n
        freedom = squared.sum() ** 2 / (squared**2 / (n - 1)).sum()
        centre, half = (
            mean[1] - mean[0],
            -float(special.stdtrit(freedom, tail)) * np.sqrt(squared.sum()),
        )
        # The upper one as the reciprocal of a lower one, which keeps the digits of a small tail.
        high, low = (
            1.0 / special.fdtri(n[0] - 1, n[1] - 1, tail),
            special.fdtri(n[1] - 1, n[0] - 1, tail),
        )
        ratio = sd[1] / sd[0]
        spread = [ratio / np.sqrt(high), ratio, ratio / np.sqrt(low)]
        yield _row(
            cell, "classical", asked.family, [centre - half, centre, centre + half], None, spread
        )


def _bayesian(first: Study, second: Study) -> Iterator[dict[str, object]]:
    """Root of the mixture of differences of conditional normals."""
    if not (first.fit and second.fit and first.fit.passed and second.fit.passed):
        return
    from percept.inference.sampling.endpoints import mixture_quantile

    asked = first.scene.inference
    rng, tail = generator(asked.seed, Stream.PAIRS), 0.5 * (1.0 - asked.level)
    of_a, of_b = (_draws(fit, rng) for fit in (first.fit, second.fit))
    count = min(len(of_a[0]), len(of_b[0]))
    # The posteriors are independent, so each pair of their draws is a draw of both: pairing each
    # draw with several others takes a third to two thirds of the error from quantiles of ratios.
    turns = rng.integers(count, size=_TURNS)
    for cell, a in first.fit.column.items():
        if (b := second.fit.column.get(cell)) is None:
            continue
        mean_a, sd_a, spread_a = (np.tile(part[:count, a], _TURNS) for part in of_a)
        mean_b, sd_b, spread_b = (
            np.concatenate([np.roll(part[:count, b], turn) for turn in turns]) for part in of_b
        )
        mean, sd = (mean_b - mean_a)[:, None], np.hypot(sd_a, sd_b)[:, None]
        lower, upper = (
            float(mixture_quantile(mean, sd, tail, upper=side)[0][0]) for side in (False, True)
        )
        spread = np.quantile(spread_b / spread_a, [tail, 0.5, 1.0 - tail]).tolist()
        above = float(special.ndtr(mean / sd).mean())
        yield _row(
            cell, "bayesian", asked.family, [lower, float(mean.mean()), upper], above, spread
        )


def _draws(fit: Fit, rng: np.random.Generator) -> list[Array]:
    """Mean, SD and spread per draw and cell, on the family's scale in their units or as logarithms."""
    some, scale = rng.permutation(len(fit.moments.mean))[:_DRAWS], fit.scale
    mean, *rest = (
        scale.unit * part[some]
        for part in (fit.moments.mean, fit.moments.sd, fit.moments.population_sd)
    )
    return [mean + (np.log(scale.origin) if scale.log else scale.origin), *rest]


def _row(
    cell: tuple[str, str],
    method: str,
    family: str,
    ends: Sequence[float],
    above: float | None,
    spread: Sequence[float],
) -> dict[str, object]:
    """Make a row of lower, value and upper of the averages' difference and of the ratio of spreads."""
    limits = np.exp(ends).tolist() if family == "lognormal" else map(float, ends)
    return {
        "environment": cell[1],
        "parameter": cell[0],
        "method": method,
        "family": family,
        **dict(zip(("lower", "value", "upper"), limits, strict=True)),
        "probability_above": above,
        **dict(
            zip(("spread_lower", "spread_value", "spread_upper"), map(float, spread), strict=True)
        ),
    }
