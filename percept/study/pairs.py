"""Two studies, groups of subjects or devices side by side: the same intervals, and their difference."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from percept.boundary.curves import curve_gap
from percept.errors import RefusalError, UsageError, counted
from percept.inference.hierarchy.density import ConditionalMoments
from percept.inference.sampling.endpoints import mixture_quantile
from percept.sessions import Sessions
from percept.sessions.records import SUMMARY_COLUMNS, TRIAL_COLUMNS
from percept.study.classical import cell_moments
from percept.study.comparison import sample_sds
from percept.study.streams import Stream, generator

if TYPE_CHECKING:
    from percept.study.study import Study

Array = NDArray[np.float64]
#: Draws of either posterior, and turns in which each draw of one meets another draw of the other.
_DRAWS, _TURNS = 8192, 16
_MOST_NAMED = 5
_SAME = (
    "A and B are the same sessions: the table of their users, whose intervals are those of two samples of "
    "different people, is left out."
)


@dataclasses.dataclass(frozen=True, eq=False)
class PairComparison:
    """Study B against study A."""

    intervals: pd.DataFrame  # environment, parameter, kind, method, family, joint
    differences: pd.DataFrame  # environment, parameter, method, family
    curves: pd.DataFrame  # As `compare_curves`, for boundaries of the two that are alike
    notes: tuple[str, ...] = ()  # Why there are no differences, and what they take for granted

    def _repr_html_(self) -> str:
        shown = self.differences.to_html(index=False, escape=True)
        about = ["Average users of B against A, and the spread between users.", *self.notes]
        return "".join(f"<p>{html.escape(text)}</p>" for text in about) + shown


def split_by(sessions: Sessions, column: str) -> dict[str, Sessions]:
    """Split a study by a column of the sessions, such as a group of subjects."""
    if sessions.form == "summary":
        raise UsageError(
            "published limits hold no subjects to divide.",
            column=column,
            hint="Give sessions, or two studies.",
        )
    if column not in sessions.table:
        known = ", ".join(str(name) for name in sessions.table.columns)
        raise UsageError(
            f"there is no such column; the columns are {known}.",
            column=column,
            hint=f'A column that is no part of the format is kept by [sessions] groups = ["{column}"].',
        )
    blank = sessions.table[column].astype(str).str.strip() == ""
    if blank.any():
        file, row = sessions.locate(int(sessions.table.index[blank][0]))
        raise UsageError(
            f"{counted(int(blank.sum()), 'row')} without a value, of no group.",
            file=file,
            row=row,
            column=column,
            hint="Fill them in, or leave such rows out with [sessions] exclude.",
        )
    parts = {
        str(value): dataclasses.replace(sessions, table=rows)
        for value, rows in sessions.table.groupby(column, sort=False)
    }
    if len(parts) < 2:
        raise UsageError("all rows have one value: there is nothing to compare.", column=column)
    groups = sessions.table.groupby("subject", sort=False)[column].nunique()
    if shared := [str(subject) for subject in groups.index[groups > 1]]:
        raise RefusalError(
            f"{_counted(shared)} in more than one group, and intervals of two samples need different people.",
            column=column,
            hint="To compare conditions that the same people went through, give each condition environments "
            "of its own: one model then holds them all.",
        )
    return parts


def compare_studies(first: Study, second: Study) -> PairComparison:
    """Compare two studies over the environments and parameters that both have."""
    for name in ("family", "level"):
        a, b = (getattr(study.scene.inference, name) for study in (first, second))
        if a != b:
            raise UsageError(
                f"the two studies are analysed with a {name} of {a} and {b}.", key=f"inference.{name}"
            )
    if not set(first.environments) & set(second.environments):
        raise RefusalError("the two studies have no environment in common, by name.")
    same = _same_sessions(first.sessions, second.sessions)
    if same and first.scene == second.scene:
        raise RefusalError(
            "A and B are the same sessions under the same scene: there is nothing to compare.",
            hint="Give the sessions of other people, or another scene.",
        )
    notes = (_SAME,) if same else _in_common(first.sessions, second.sessions)
    notes += tuple(_left_out(first, second)) + tuple(_other_claims(first, second))
    notes += () if same else tuple(_other_trials(first.sessions, second.sessions))
    keys = ["environment", "parameter", "kind", "method", "family", "joint"]
    pair = [study.intervals[[*keys, "lower", "upper"]] for study in (first, second)]
    intervals = pair[0].merge(pair[1], on=keys, suffixes=("_a", "_b"))
    widths = [intervals[f"upper_{side}"] - intervals[f"lower_{side}"] for side in ("a", "b")]
    intervals["width_ratio"] = widths[1] / widths[0]
    differences = []
    if not same:
        differences = _classical(first, second) + _bayesian(
            first, second, generator(first.scene.inference.seed, Stream.PAIRS)
        )
    return PairComparison(intervals, pd.DataFrame(differences), _curves(first, second), notes)


def _left_out(first: Study, second: Study) -> Iterator[str]:
    """Say what only one of the two has."""
    for what in ("environments", "parameters"):
        names = [[str(name) for name in getattr(study, what)] for study in (first, second)]
        for label, own, other in (("A", *names), ("B", *reversed(names))):
            if alone := [name for name in own if name not in other]:
                yield f"Only {label} has {', '.join(alone)}: left out."


def _other_claims(first: Study, second: Study) -> Iterator[str]:
    """Say where intervals of kind share claim different things."""
    asked = [study.scene.inference for study in (first, second)]
    if any("share" not in one.kinds for one in asked):
        return
    claims = [(one.held_share, one.confidence) for one in asked]
    if claims[0] != claims[1]:
        said = " and ".join(
            f"{share:g} of users with confidence {confidence:g}" for share, confidence in claims
        )
        yield f"Intervals of kind share hold {said}: their widths differ for that reason too."


def _other_trials(first: Sessions, second: Sessions) -> Iterator[str]:
    """Say where subjects' means hold different amounts of trial noise."""
    if {first.form, second.form} != {"trials"}:
        return
    usual = [
        float(one.table.groupby(["subject", "environment"], sort=False).size().median())
        for one in (first, second)
    ]
    if usual[0] != usual[1]:
        made = f"{usual[0]:g} trials of an environment in A and {usual[1]:g} in B"
        yield (
            f"Subjects typically made {made}: more of the trial noise is left in the classical spreads of "
            "the study with fewer."
        )


def _same_sessions(first: Sessions, second: Sessions) -> bool:
    if first.form != second.form:
        return False
    columns = list(TRIAL_COLUMNS if first.form == "trials" else SUMMARY_COLUMNS)
    return first.table[columns].equals(second.table[columns])


def _in_common(first: Sessions, second: Sessions) -> tuple[str, ...]:
    """Note subjects named alike; refuse them where the studies share a file and they are the same people."""
    known = set(second.subjects)
    shared = [subject for subject in first.subjects if subject in known]
    if not shared:
        return ()
    contents = {source.sha256 for source in second.sources}
    files = [source.name for source in first.sources if source.sha256 in contents]
    if files:
        raise RefusalError(
            f"{_counted(shared)} in both studies, and intervals of two samples need different people.",
            file=files[0],
            hint="Keep each subject in one of the two: [sessions] only, in a scene, chooses rows.",
        )
    return (
        f"{_counted(shared)} in both studies by name, and taken for different people: if they are the same, "
        "the intervals of the differences do not hold.",
    )


def _counted(subjects: Sequence[str]) -> str:
    named = ", ".join(subjects[:_MOST_NAMED])
    more = ", …" if len(subjects) > _MOST_NAMED else ""
    return f"{counted(len(subjects), 'subject')} ({named}{more}) {'is' if len(subjects) == 1 else 'are'}"


def _classical(first: Study, second: Study) -> list[dict[str, object]]:
    """Welch's interval of the difference of means, and the F interval of the ratio of SDs."""
    family = first.scene.inference.family
    if "bayesian" in (first.scene.inference.method, second.scene.inference.method):
        return []
    tail = 0.5 * (1.0 - first.scene.inference.level)
    log = family == "lognormal"
    counts = [
        {(c.parameter, c.environment): c.moments for c in cell_moments(s.sessions, s.parameters, family)}
        for s in (first, second)
    ]
    sds = [sample_sds(s.sessions, s.parameters, family) for s in (first, second)]
    rows: list[dict[str, object]] = []
    for cell in sds[0]:
        moments = [part.get(cell) for part in counts]
        if cell not in sds[1] or moments[0] is None or moments[1] is None:
            continue
        on_scale = [m.on_scale("lognormal" if log else "normal") for m in moments if m is not None]
        mean, sd, n = (
            np.array([float(np.asarray(getattr(m, f))) for m in on_scale]) for f in ("mean", "sd", "n")
        )
        share = sd**2 / n
        freedom = share.sum() ** 2 / (share**2 / (n - 1)).sum()
        centre = mean[1] - mean[0]
        reach = -float(special.stdtrit(freedom, tail)) * np.sqrt(share.sum())
        ends = np.array([centre - reach, centre, centre + reach])
        spread = sd[1] / sd[0]
        # The upper one as the reciprocal of a lower one, which keeps the digits of a small tail.
        quantiles = [1.0 / special.fdtri(n[0] - 1, n[1] - 1, tail), special.fdtri(n[1] - 1, n[0] - 1, tail)]
        rows.append(
            _row(cell, "classical", family, np.exp(ends) if log else ends)
            | {
                "probability_above": None,
                "spread_lower": spread / np.sqrt(quantiles[0]),
                "spread_value": spread,
                "spread_upper": spread / np.sqrt(quantiles[1]),
            }
        )
    return rows


def _bayesian(first: Study, second: Study, rng: np.random.Generator) -> list[dict[str, object]]:
    """Root of the mixture of differences of conditional normals.

    The two posteriors are independent, so every pair of their draws is a draw of both: pairing each draw with
    several others takes a third to two thirds of the error from quantiles of ratios.
    """
    fits = [study.fit for study in (first, second)]
    if any(fit is None or not fit.run.gate.passed for fit in fits):
        return []
    family, level = first.scene.inference.family, first.scene.inference.level
    log, tail = family == "lognormal", 0.5 * (1.0 - level)
    parts = []
    for fit in fits:
        assert fit is not None
        components = fit.run.components.reshape(-1, fit.run.components.shape[-1])
        laws = ConditionalMoments.unpack(components[rng.permutation(len(components))[:_DRAWS]])
        scale = fit.prepared.scale
        origin = np.log(scale.origin) if log else scale.origin
        unit = scale.unit
        column = {cell: c for c, cell in enumerate(fit.prepared.model.cells)}
        parts.append((origin + unit * laws.mean, unit * laws.sd, unit * laws.population_sd, column))
    (*of_a, column_a), (*of_b, column_b) = parts
    count = min(len(of_a[0]), len(of_b[0]))
    turns = rng.integers(count, size=_TURNS)
    rows: list[dict[str, object]] = []
    for cell in column_a:
        if cell not in column_b:
            continue
        mean_a, sd_a, spread_a = (np.tile(law[:count, column_a[cell]], _TURNS) for law in of_a)
        mean_b, sd_b, spread_b = (
            np.concatenate([np.roll(law[:count, column_b[cell]], turn) for turn in turns]) for law in of_b
        )
        mean, sd = (mean_b - mean_a)[:, None], np.hypot(sd_a, sd_b)[:, None]
        lower, upper = (float(mixture_quantile(mean, sd, tail, upper=side)[0][0]) for side in (False, True))
        ends = np.array([lower, float(mean.mean()), upper])
        ratio = np.quantile(spread_b / spread_a, [tail, 0.5, 1.0 - tail])
        rows.append(
            _row(cell, "bayesian", family, np.exp(ends) if log else ends)
            | {
                "probability_above": float(special.ndtr(mean / sd).mean()),
                "spread_lower": float(ratio[0]),
                "spread_value": float(ratio[1]),
                "spread_upper": float(ratio[2]),
            }
        )
    return rows


def _row(cell: tuple[str, str], method: str, family: str, ends: Array) -> dict[str, object]:
    lower, value, upper = ends.tolist()
    what = {"environment": cell[1], "parameter": cell[0], "method": method, "family": family}
    return {**what, "lower": lower, "value": value, "upper": upper}


def _curves(first: Study, second: Study) -> pd.DataFrame:
    labels = ("environment", "kind", "method", "family", "joint", "shape")
    if first.apparatus is None or second.apparatus is None:
        return pd.DataFrame()
    known = {tuple(getattr(b, name) for name in labels): b for b in second.boundaries}
    rows = []
    for boundary in first.boundaries:
        key = tuple(getattr(boundary, name) for name in labels)
        other = known.get(key)
        if other is None:
            continue
        row: dict[str, object] = dict(zip(labels, key, strict=True))
        for side, gap in curve_gap(boundary, other).items():
            row |= {f"area_{side}": gap.area, f"largest_{side}": gap.largest, f"omega_{side}": gap.omega}
        rows.append(row)
    return pd.DataFrame(rows)
