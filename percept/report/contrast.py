"""Factors, groups and covariates: how their levels differ, in sentences and in one table."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.numbers import bare, digits_of, rounded
from percept.report.sections import NOTHING, Cell, Section, Table, ends, of, table_of, with_limits
from percept.report.select import (
    KINDS,
    METHODS,
    Words,
    distinct,
    listed,
    matching,
    ordered,
    words_of,
)
from percept.results import ContrastRow, LevelValues, Results
from percept.sessions.formula import TRIAL_REFERENCE

__all__ = [
    "Design", "LevelPanel", "Size", "contrast", "contrast_sentences", "design_words",
    "level_panels", "size_of",
]  # fmt: skip

#: What is compared, in the order of the table.
_PARTS = ("interaction", "level", "bias", "spread", "precision", "slope")
_OF = {"bias": "bias", "level": "mean bias", "spread": "spread", "precision": "precision"}
#: Digits of an estimate, at least: beside a wide interval it has the digits of the narrow one.
_LEAST_DIGITS = 3


@dataclasses.dataclass(frozen=True)
class Size:
    """How a contrast is written: a ratio, or a difference in the unit of the data."""

    ratio: bool
    scale: float
    unit: str

    @property
    def axis(self) -> str:
        """The unit as an axis has it."""
        return f" ({self.unit.strip()})" if self.unit else ""

    def scaled(self, row: ContrastRow) -> tuple[float, float, float]:
        """Return lower and upper limit and the estimate in the unit."""
        return self.scale * row.lower, self.scale * row.upper, self.scale * row.estimate

    def of(self, row: ContrastRow, value: float, least: int = _LEAST_DIGITS) -> str:
        """Write a value with the digits of the row's estimate, without its sign."""
        digits = max(digits_of(row.estimate, row.lower, row.upper), least)
        return bare(rounded(abs(self.scale * value), digits))

    def signed(self, row: ContrastRow, value: float, least: int = _LEAST_DIGITS) -> str:
        """Write a value; a difference with its sign."""
        sign = "" if self.ratio or value == 0.0 else "−" if value < 0.0 else "+"
        return sign + self.of(row, value, least)

    def limits(self, row: ContrastRow, *, together: bool = False) -> str:
        """Write both limits with their unit, and what they claim."""
        low = row.lower_together if together else row.lower
        high = row.upper_together if together else row.upper
        claim = f"{percent(row.level)}, together" if together else percent(row.level)
        lower = self.signed(row, low or 0.0, 2)
        upper = self.signed(row, high or 0.0, 2)
        return f"{claim}: {lower} to {upper}{self.unit}"


def size_of(row: ContrastRow, results: Results) -> Size:
    """Return how a contrast is written; a part of references in their unit, if they are equal."""
    if row.family == "lognormal" or row.kind is None:
        return Size(True, 1.0, "")
    if row.unit != "references":
        # Pure numbers have no word for their unit.
        return Size(False, 1.0, f" {row.unit}".replace(" units", "").rstrip())
    sizes = set()
    for cell in matching(results.intervals, parameter=row.parameter):
        if cell.environment.startswith(row.references):
            sizes.add(cell.reference)
    if len(sizes) == 1 and None not in sizes:
        unit = results.data.quantities[row.parameter].unit
        return Size(False, float(sizes.pop() or 0.0), f" {unit}".rstrip())
    return Size(False, 100.0, " % of the reference")


def contrast(results: Results) -> Section:
    """Return the section: sentences on every contrast of users, one table, and tests of terms."""
    rows = results.contrast
    words = words_of(results)
    parameters = distinct(rows, "parameter")
    pairs = list(dict.fromkeys((row.factor, row.first, row.second) for row in rows))

    def place(row: ContrastRow) -> tuple[int, int, int]:
        pair = pairs.index((row.factor, row.first, row.second))
        return _PARTS.index(row.of), pair, parameters.index(row.parameter)

    ratio = bool(rows) and rows[0].family == "lognormal"
    ordered_rows = sorted(rows, key=place)
    return Section(
        "contrast",
        f"Differences between levels of {listed(distinct(rows, 'factor'))}" if rows else "",
        sentences=_grounds(rows, words),
        tables=[_table(ordered_rows, results, ratio=ratio), *_anova(results, ratio=ratio)],
        figures=[panel.name for panel in level_panels(results)],
    )


def _grounds(rows: Sequence[ContrastRow], words: Words) -> list[str]:
    """Say what contrasts rest on."""
    within = listed(distinct(matching(rows, within=True), "factor"))
    groups = listed(distinct(matching(rows, within=False), "factor"))
    sentences = []
    if within:
        sentences.append(
            f"Every {words.subject} went through all levels of {within}: contrasts pair each"
            f" {words.subject}’s own means. Classical limits are paired t, prediction and tolerance"
            " intervals, of spread Pitman and Morgan’s."
        )
    if groups:
        sentences.append(
            f"Different {words.subjects} are compared in {groups}. Classical limits are Welch’s, of"
            " spread F limits."
        )
    if matching(rows, of="precision"):
        sentences.append(
            f"Precision is the ratio of SDs between a {words.subject}’s trials, and so of JNDs and"
            " Weber fractions. Its classical limits are paired t or Welch’s, of log SDs."
        )
    if matching(rows, method="bayesian"):
        sentences.append(
            "All Bayesian contrasts come from one posterior. All contrasts of a factor lie within"
            " their “together” limits with the stated probability."
        )
    if rows:
        sentences.append("Overall contrasts give all references the same weight.")
    return sentences


def _table(rows: Sequence[ContrastRow], results: Results, *, ratio: bool) -> Table:
    """Return the one table of all contrasts."""
    words = words_of(results)

    def style(row: ContrastRow) -> str:
        return "difference percent" if row.unit == "references" else "plain"

    def where(row: ContrastRow) -> str:
        return row.environment or f"overall, {len(row.references)} of {row.of_references}"

    def compared(row: ContrastRow) -> str:
        unit = "% of the reference" if row.unit == "references" else row.unit
        named = _OF.get(row.of, f"{row.of} {row.factor}")
        return f"{named} ({unit})" if unit else named

    def together(row: ContrastRow) -> Cell:
        if row.lower_together is None:
            return NOTHING
        return ends(row, "lower_together", "upper_together", style=style(row))

    above = "P(> 1)" if ratio else "P(> 0)"
    columns = {
        "Contrast": lambda row: f"{row.second} against {row.first}",
        capitalised(words.environment): where,
        "Quantity": lambda row: results.data.quantities[row.parameter].label,
        "Of": compared,
        "Kind": lambda row: row.kind or "–",
        "Method": lambda row: row.method,
        "estimate (limits)": lambda row: with_limits(row, style=style(row), least=_LEAST_DIGITS),
        "together": together,
        "p": of("p_value", 2),
        above: of("probability_above", 3, style="percent"),
        "d_z": of("d_z", 2),
        words.subjects: of("n", style="count"),
    }
    optional = {"together": "lower_together", above: "probability_above", "d_z": "d_z"}
    for head, name in optional.items():
        if all(getattr(row, name) is None for row in rows):
            del columns[head]
    measure = "the first over the second" if ratio else "the first less the second"
    caption = f"Contrasts of levels: {measure}; spreads as ratios of SDs."
    return table_of(caption, rows, columns, name="contrast", csv="contrast")


def _anova(results: Results, *, ratio: bool) -> list[Table]:
    """Return a table of the tests of terms for each quantity."""
    words = words_of(results)
    tables = []
    for name in distinct(results.anova, "parameter"):
        measure = "log ratios" if ratio else "differences"
        caption = (
            f"Analysis of variance of {results.data.quantities[name].words}, {words.subjects}’ mean"
            f" {measure}; degrees of freedom by Greenhouse and Geisser’s ε."
        )
        columns = {
            "Term": lambda row: row.factor.replace(":", " × "),
            "F": of("f", 4),
            "df": of("df_corrected", 4),
            "df of error": of("df_error_corrected", 4),
            "ε": of("epsilon", 3),
            "p": of("p_corrected", 2),
            "partial η²": of("partial_eta2", 2),
            "generalised η²": of("generalised_eta2", 2),
        }
        rows = matching(results.anova, parameter=name)
        tables.append(table_of(caption, rows, columns, name=f"anova_{name}", csv="anova"))
    return tables


@dataclasses.dataclass(frozen=True)
class LevelPanel:
    """A figure of one quantity over the levels of one factor."""

    name: str  # Of its file, without ending
    parameter: str
    factor: str
    means: list[ContrastRow]  # The average user at every level, by both methods


def level_panels(results: Results) -> list[LevelPanel]:
    """Return a panel per quantity and factor whose levels have means."""
    found = []
    pairs = dict.fromkeys((row.parameter, row.factor) for row in results.levels)
    for number, (parameter, factor) in enumerate(pairs, start=1):
        of_factor = matching(results.contrast, parameter=parameter, factor=factor)
        means = matching(of_factor, of="level", kind="mean")
        if means:
            found.append(LevelPanel(f"levels_{parameter}_{number}", parameter, factor, means))
    return found


@dataclasses.dataclass(frozen=True)
class Design:
    """Factors, groups and covariates of a study, as the methods paragraph names them."""

    within: str  # "2 levels of hand and 3 levels of load"; empty without
    groups: list[str]  # "12 novice and 11 expert (group)"
    covariates: str
    own_slopes: str  # Covariates of which each subject has a slope


def design_words(results: Results) -> Design:
    """Name the levels of factors, the sizes of groups, and the covariates."""
    # Of several quantities the first has the same levels.
    every = matching(results.levels, parameter=results.data.parameters[0])
    levels = matching(every, environment=None)
    within = []
    groups = []
    for factor in distinct(levels, "factor"):
        of_factor = matching(levels, factor=factor)
        if of_factor[0].within:
            within.append(f"{len(of_factor)} levels of {factor}")
            continue
        sizes = []
        for row in of_factor:
            of_level = matching(every, factor=factor, level=row.level)
            sizes.append(f"{_subjects_at(of_level)} {row.level}")
        groups.append(f"{listed(sizes)} ({factor})")
    slopes = matching(results.contrast, of="slope")
    covariates = listed(distinct(slopes, "factor"))
    own_slopes = listed(distinct(matching(slopes, within=True), "factor"))
    return Design(listed(within), groups, covariates, own_slopes)


def _subjects_at(rows: Sequence[LevelValues]) -> int:
    """Count the subjects with a value in any of the rows: some lack references, and an overall."""
    by_subject = zip(*(row.values for row in rows), strict=True)
    return sum(any(value is not None for value in values) for values in by_subject)


def _clearest(rows: Sequence[ContrastRow]) -> list[ContrastRow]:
    """Return each factor's clearest contrast of each quantity: interactions first.

    It is over all references where there is such a one, of the average user, and of the best
    method.
    """
    of_users = [row for row in rows if row.of not in ("level", "spread", "precision")]
    found = []
    for factor, parameter in dict.fromkeys((row.factor, row.parameter) for row in of_users):
        of_factor = matching(of_users, factor=factor, parameter=parameter)
        of_factor = matching(of_factor, kind=ordered(KINDS, of_factor, "kind")[0])
        of_factor = matching(of_factor, method=ordered(METHODS[::-1], of_factor, "method")[0])
        found.append(max(matching(of_factor, environment=None) or of_factor, key=_clarity))
    return sorted(found, key=lambda row: row.of != "interaction")


def _clarity(row: ContrastRow) -> float:
    """Return how many lengths of its interval a contrast lies from none."""
    centre = 1.0 if row.family == "lognormal" else 0.0
    return abs(row.estimate - centre) / (row.upper - row.lower or 1.0)


def contrast_sentences(results: Results) -> list[str]:
    """Say how levels differ: each factor's clearest contrast, with its interval."""
    words = words_of(results)
    sentences = []
    for row in _clearest(results.contrast):
        said = _difference(row, results, words)
        rests_on = []
        if row.n < row.of_subjects:
            rests_on.append(f"{row.n} of {row.of_subjects} {words.subjects}")
        if row.environment is None and len(row.references) < row.of_references:
            rests_on.append(f"{len(row.references)} of {row.of_references} references")
        if rests_on:
            said += f" It rests on {listed(rests_on)}."
        sentences.append(said)
    return sentences


def _is_clear(row: ContrastRow) -> bool:
    """Say whether the limits, joint ones where there are such, leave out that nothing differs."""
    lower = row.lower if row.lower_together is None else row.lower_together
    upper = row.upper if row.upper_together is None else row.upper_together
    centre = 1.0 if row.family == "lognormal" else 0.0
    return not lower <= centre <= upper


def _difference(row: ContrastRow, results: Results, words: Words) -> str:
    """Say how the second level differs from the first."""
    size = size_of(row, results)
    quantity = results.data.quantities[row.parameter]
    who = {"user": f"next {words.user}’s ", "share": f"most {words.users}’ "}.get(
        row.kind or "", ""
    )
    what = f"{who}{quantity.label}" + (f" in {row.environment}" if row.environment else "")
    limits = size.limits(row)
    first, second = row.first, row.second
    if row.of == "slope":
        if row.factor == TRIAL_REFERENCE:
            return _along_the_reference(row, size, what)
        second = f"{row.second} of {row.factor}"
    if row.of == "interaction":
        what, first, second = _interaction(row, what)
    if not _is_clear(row):
        limits = size.limits(row, together=row.lower_together is not None)
        times = " times" if size.ratio else size.unit
        estimate = size.signed(row, row.estimate)
        return (
            f"{capitalised(second)} and {first} do not differ clearly in the {what}:"
            f" {estimate}{times} ({limits})."
        )
    if size.ratio:
        more = f"{size.of(row, row.estimate)} times as high"
        return f"The {what} is {more} for {second} as for {first} ({limits})."
    sides = ("higher", "lower") if quantity.is_matched else ("larger", "smaller")
    side = sides[row.estimate < 0.0]
    more = f"{size.of(row, row.estimate)}{size.unit} {side}"
    return f"The {what} is {more} for {second} than for {first} ({limits})."


def _interaction(row: ContrastRow, what: str) -> tuple[str, str, str]:
    """Name what an interaction compares: the change over one factor, at two levels of the rest."""
    start, _, rest = row.first.partition(", ")
    end, _, other = row.second.partition(", ")
    return f"change of the {what} from {start} to {end}", rest, other


def _along_the_reference(row: ContrastRow, size: Size, what: str) -> str:
    """Say how settings change over a decade of the reference."""
    limits = size.limits(row)
    if not size.ratio:
        way = "falls" if row.estimate < 0 else "rises"
        change = f"{size.of(row, row.estimate)}{size.unit}"
        return (
            f"Per decade of reference the difference of {what} from the reference {way} by"
            f" {change} ({limits})."
        )
    way = "falls" if row.estimate < 1 else "rises"
    # The reference itself is ten times as high.
    return (
        f"Per decade of reference the {what} is {size.of(row, 10.0 * row.estimate)} times as high:"
        f" the ratio to the reference {way} to {size.of(row, row.estimate)} times ({limits})."
    )
