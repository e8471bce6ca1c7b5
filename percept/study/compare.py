"""Two studies, of other people or devices: the same intervals, and their difference."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy import special

from percept.errors import RefusalError, UsageError, counted
from percept.html import NotebookRecord
from percept.inference.classical.contrasts import group_contrast, group_spread_ratio
from percept.inference.record import Method
from percept.results import BandPair, ContrastRow
from percept.sessions import Sessions
from percept.study.basics import Array, Stream, generator
from percept.study.boundaries import band_pairs
from percept.study.comparisons import Contrast
from percept.study.contrasts import contrast_row, ends_of

if TYPE_CHECKING:
    from percept.study.fit import Fit
    from percept.study.study import Study


#: Pairs of draws of the two posteriors: quantiles at 99 % err by 2e-4 of their probability.
_PAIRS = 1 << 17
#: Subjects named in a message; of more a sentence would be unreadable.
_MOST_NAMED = 5
_SAME_SESSIONS = (
    "A and B are the same sessions: the table of their users, whose intervals assume two samples of"
    " different people, is left out."
)
#: By cell: lower limit, upper limit and estimate of the difference of averages, and of the ratio of
#: spreads; subjects; and evidence.
_Tests = dict[tuple[str, str], tuple[Array, Array, int, dict[str, Any]]]
_LABELS = ("environment", "parameter", "kind", "method", "family", "joint")
#: Frequencies that curves are compared at, some 80 a decade over the usual range.
_POINTS = 241


@dataclasses.dataclass(frozen=True, eq=False)
class PairComparison(NotebookRecord):
    """Study B against study A."""

    #: Both studies' limits per environment, parameter, kind, method, family and joint, and the
    #: widths' ratio.
    intervals: pd.DataFrame
    #: B's users against A's as two levels of a factor are contrasted, `ContrastRow`: "bias" of the
    #: average user (ratio, or difference in the quantity's unit), and "spread".
    differences: pd.DataFrame
    curves: pd.DataFrame  #: How B's exact envelopes differ from A's: a `BandPair` a row
    notes: tuple[str, ...] = ()  #: Why there are no differences, and what they take for granted


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
    notes = [_SAME_SESSIONS] if same else list(_in_common(first.sessions, second.sessions))
    notes += _left_out(first.data.environments, second.data.environments)
    notes += _left_out(first.data.parameters, second.data.parameters)
    found = [] if same else list(_differences(first, second))
    notes += [note for note in found if isinstance(note, str)]
    return PairComparison(
        _intervals(first, second),
        pd.DataFrame([row for row in found if not isinstance(row, str)]),
        pd.DataFrame(list(_bands(first, second))),
        tuple(notes),
    )


def _intervals(first: Study, second: Study) -> pd.DataFrame:
    """Limits that both studies have, and their widths' ratio."""
    columns = [*_LABELS, "lower", "upper"]
    of_b = second.intervals[columns]
    both = first.intervals[columns].merge(of_b, on=list(_LABELS), suffixes=("_a", "_b"))
    width = both["upper_b"] - both["lower_b"]
    return both.assign(width_ratio=width / (both["upper_a"] - both["lower_a"]))


def _left_out(of_a: Sequence[str], of_b: Sequence[str]) -> Iterator[str]:
    """Name the environments, or parameters, that one study has alone."""
    for label, names, other in (("A", of_a, of_b), ("B", of_b, of_a)):
        alone = [name for name in names if name not in other]
        if alone:
            yield f"Only {label} has {', '.join(alone)}: left out."


def _bands(first: Study, second: Study) -> Iterator[BandPair]:
    """How the exact envelopes of B differ from A's, over the frequencies that both study."""
    lower = max(first.scene.frequency.lower, second.scene.frequency.lower)
    upper = min(first.scene.frequency.upper, second.scene.frequency.upper)
    if lower < upper:
        omega = np.geomspace(lower, upper, _POINTS)
        of_a = first.envelopes_at(omega)
        of_b = second.envelopes_at(omega)
        yield from band_pairs(of_a, of_b, "environment", "kind", "method", "family")


def _same_sessions(first: Sessions, second: Sessions) -> bool:
    """Whether the columns that both have hold the same rows."""
    if first.form != second.form or first.quantities != second.quantities:
        return False
    columns = [name for name in first.table if name in second.table]
    return first.table[columns].equals(second.table[columns])


def _in_common(first: Sessions, second: Sessions) -> Iterator[str]:
    """Note subjects of the same name; refuse them where the studies share a file."""
    shared = [subject for subject in first.subjects if subject in set(second.subjects)]
    if not shared:
        return
    named = shared[:_MOST_NAMED] + ["…"] * (len(shared) > _MOST_NAMED)
    verb = "is" if len(shared) == 1 else "are"
    who = f"{counted(len(shared), 'subject')} ({', '.join(named)}) {verb} in both studies"
    contents = {source.sha256 for source in second.sources}
    for source in first.sources:
        if source.sha256 in contents:
            raise RefusalError(
                f"{who}, and intervals of two samples need different people.",
                file=source.name,
                hint="Keep each subject in one of the two: [sessions] only, in a scene, chooses"
                " rows.",
            )
    yield (
        f"{who} by name, and taken for different people: if they are the same, the intervals of the"
        " differences do not hold."
    )


def _differences(first: Study, second: Study) -> Iterator[ContrastRow | str]:
    """Yield B's users against A's in each cell, by each method that both have; or say why not."""
    data = second.data
    family = data.asked.family
    methods: dict[Method, _Tests] = {
        "classical": _classical(first, second),
        "bayesian": _bayesian(first, second),
    }
    for (method, tests), cell in itertools.product(methods.items(), data.reference):
        parameter, environment = cell
        if not tests or cell not in first.data.reference:
            continue
        if cell not in tests:
            yield (
                f"No {method} difference of {parameter} in {environment}: in A or B it has no"
                f" interval of the {family} family."
            )
            continue
        difference, ratio, n, evidence = tests[cell]
        bias = Contrast(
            parameter=parameter,
            factor="study",
            first="A",
            second="B",
            of="bias",
            within=False,
            environment=environment,
            references=(environment,),
        )
        # Of logarithms the row is a ratio.
        unit = None if family == "lognormal" else data.quantities[parameter].unit
        yield contrast_row(data, bias, difference, n, method=method, unit=unit, **evidence)
        spread = dataclasses.replace(bias, of="spread")
        yield contrast_row(data, spread, ratio, n, method=method)


def _classical(first: Study, second: Study) -> _Tests:
    """Welch's interval of the difference of means, and the F interval of the ratio of SDs."""
    asked = first.scene.inference
    found: _Tests = {}
    if "bayesian" in (asked.method, second.scene.inference.method):
        return found
    of_b = second.data.moments(asked.family)
    for cell, a in first.data.moments(asked.family).items():
        if cell in of_b:
            difference = group_contrast(a, of_b[cell], level=asked.level)
            ratio = group_spread_ratio(a, of_b[cell], level=asked.level)
            evidence = {"p_value": difference.p_value}
            found[cell] = (ends_of(difference), ends_of(ratio), difference.n, evidence)
    return found


def _bayesian(first: Study, second: Study) -> _Tests:
    """Limits of a mixture of normals, and quantiles of ratios, of both posteriors."""
    a = first.passed
    b = second.passed
    found: _Tests = {}
    if a is None or b is None:
        return found
    from percept.inference.sampling.endpoints import mixture_limits

    asked = first.scene.inference
    rng = generator(asked.seed, Stream.PAIRS)
    # The posteriors are independent, so each pair of their draws is a draw of both.
    of_a = rng.integers(len(a.moments.mean), size=_PAIRS)
    of_b = rng.integers(len(b.moments.mean), size=_PAIRS)
    tail = 0.5 * (1.0 - asked.level)
    for cell in a.column:
        if cell not in b.column:
            continue
        mean_a, sd_a, spread_a = _population(a, cell)[:, of_a]
        mean_b, sd_b, spread_b = _population(b, cell)[:, of_b]
        mean = (mean_b - mean_a)[:, None]
        sd = np.hypot(sd_a, sd_b)[:, None]
        lower, upper, _ = mixture_limits(mean, sd, tail)
        n = int(a.counts[a.column[cell]] + b.counts[b.column[cell]])
        ends = np.array([lower[0], upper[0], mean.mean()])
        ratios = np.quantile(spread_b / spread_a, [tail, 1.0 - tail, 0.5])
        above = float(special.ndtr(mean / sd).mean())
        found[cell] = (ends, ratios, n, {"probability_above": above})
    return found


def _population(fit: Fit, cell: tuple[str, str]) -> Array:
    """Draws of mean, its SD and the SD between users, (3, S), in units or of logarithms."""
    c = fit.column[cell]
    scale = fit.scale.at(c)
    drawn = scale.unit * fit.moments.of([c]).pack().T
    drawn[0] += scale.centre
    return drawn
