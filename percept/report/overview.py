"""The answer first: decisions in sentences, a row per environment, and cautions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from scipy import special

from percept.errors import capitalised, counted
from percept.inference.record import percent
from percept.report.adjustments import contrast_sentences, level_figures
from percept.report.basics import (
    METHOD_NAMES,
    NOTHING,
    Cell,
    Columns,
    Estimated,
    Section,
    Table,
    bracketed,
    column,
    distinct,
    estimate,
    family_of,
    grouped,
    listed,
    matching,
    of,
    possessive,
    short,
    table_of,
    value,
)
from percept.report.biases import bias_sentences, biases_of, user_sentences
from percept.report.decisions import (
    FEELINGS,
    RENDERED,
    coupling_sentences,
    device_sentence,
    doubtful_rendering,
    doubtful_verdicts,
    feeling_sentences,
)
from percept.report.display import centrals
from percept.report.methods import who_gave_what
from percept.results import MOST_SHOWN, Findings, Results

_MOST_SENTENCES = 3


def findings(results: Results) -> Findings:
    """Say what the first screen says, and the results in a paragraph to paste."""
    sentences = [*contrast_sentences(results), *setting_sentences(results)]
    sentences += feeling_sentences(results)
    if sentences and results.data.simulated:
        sentences.insert(0, "These results are of simulated data.")
    paragraph = " ".join(sentences)
    return Findings(tuple(decide(results)), tuple(cautions(results)), paragraph)


def decide(results: Results) -> list[str]:
    """Return at most three statements: what is so, how sure, and what to do next.

    A model that overrules the data is said before them.
    The study's own contrasts come first; then what can be rendered and feels real. Without a
    device, how far users set each quantity off.
    """
    statements = contrast_sentences(results)
    feelings = feeling_sentences(results)
    if feelings:
        statements = [*statements[:1], " ".join(feelings)]
        statements += [" ".join(coupling_sentences(results)), device_sentence(results)]
    else:
        statements += setting_sentences(results)
    return [*overruled(results), *list(filter(None, statements))[:_MOST_SENTENCES]]


def setting_sentences(results: Results) -> list[str]:
    """Say how far users set each quantity off, and where the next user's settings lie."""
    return bias_sentences(results) + user_sentences(results)


def summary(results: Results, found: Findings) -> Section:
    """Return the first screen: decisions, the table of environments, cautions and a figure."""
    every = distinct(biases_of(results), "environment")
    gate = results.diagnostics.gate if results.diagnostics else None
    withheld = "The Bayesian numbers are withheld: the sampler did not pass its checks."
    return Section(
        "summary",
        "Summary",
        parts=[
            Section("withheld", "", [withheld] if gate and not gate.passed else [], form="warning"),
            Section("decisions", "", found.sentences, form="list"),
            Section(
                "environments",
                tables=[_environments(results, every), centrals(results)],
            ),
            Section("cautions", "Before you rely on it", found.cautions, form="warning"),
            Section("source", "", [who_gave_what(results)], figures=list(level_figures(results))),
        ],
    )


def _environments(results: Results, names: Sequence[str]) -> Table:
    """Return the table with a row per environment; of many, of the first."""
    if not names:
        return Table()
    words = results.data.words
    biases = biases_of(results)
    columns: Columns = {capitalised(words.environment): str}
    last: Columns = {}
    for parameter, chosen in grouped(biases, "parameter").items():
        quantity = results.data.quantities[parameter]
        head = f"Mean {quantity.symbol}"
        if quantity.is_matched:
            head = f"Bias of {quantity.symbol}"
            reference = column(chosen, "environment", of("row.reference", style="short"))
            columns[f"Reference {quantity.symbol}{bracketed(quantity.unit)}"] = reference
        last[head + bracketed(chosen[0].unit)] = column(
            chosen, "environment", lambda bias: estimate(bias, bias.style)
        )
    for coupled in distinct(results.rendering or results.verdicts, "coupled"):
        columns[capitalised(RENDERED[coupled])] = displayed(results, coupled=coupled)
    row = biases[0].row
    what = f"Bias of the average {words.user}"
    if biases[0].style == "plain":
        what = f"Mean of all {words.users}"
    geometric = " (geometric mean)" if row.family == "lognormal" else ""
    caption = (
        f"{what}{geometric} with {percent(row.level)} limits ({METHOD_NAMES[row.method]},"
        f" {row.family})."
    )
    if results.verdicts:
        verdict = results.verdicts[0]
        measure = "probability" if verdict.method == "bayesian" else "confidence"
        caption += (
            f" Real: among the central {percent(verdict.central)} of {words.users} at every ω, with"
            f" {percent(verdict.decision)} {measure}."
        )
    if len(names) > MOST_SHOWN:
        caption += f" The first {MOST_SHOWN} of {len(names)}; the sections below have all."
    shown = names[:MOST_SHOWN]
    return table_of(caption, shown, columns | last, name="overview", csv="intervals")


def displayed(results: Results, *, coupled: bool) -> Callable[[str], Cell]:
    """Return what makes a cell on rendering, and on feeling real of what can be rendered."""
    verdicts = {row.environment: row for row in matching(results.verdicts, coupled=coupled)}
    rendering = matching(results.rendering or (), coupled=coupled)
    rendered = {row.environment: row.verdict for row in rendering}

    def cell(name: str) -> Cell:
        words = {"cannot": "cannot be rendered", "undecided": "rendering not decided"}
        if rendered.get(name) in words:
            return (words[rendered[name]],)
        if name not in verdicts:
            return ("can be rendered",) if name in rendered else NOTHING
        verdict = verdicts[name]
        return (FEELINGS[verdict.outcome], ", ", *value(verdict.probability, 3, "percent"))

    return cell


_FEW = 5  # fewer subjects than this are called few
#: Classical standard errors between the model's mean and the data's from which one is told first.
_OVERRULED = 2.0
#: Width over that of the classical interval, from which on the prior of the spread is told.
_WIDENED = 1.5
#: What a statistic of a cell says of the data where it is too high or too low for the model.
_UNEXPECTED = {
    ("mean", "high"): "the mean of {quantity} is higher",
    ("mean", "low"): "the mean of {quantity} is lower",
    ("sd", "high"): "{subjects} differ more in {quantity}",
    ("sd", "low"): "{subjects} differ less in {quantity}",
    ("farthest", "high"): "one {subject} lies farther from the others in {quantity}",
    ("farthest", "low"): "the {subjects} lie closer together in {quantity}",
}
_REJECTED = 0.05  # p of all tests of normality together
_WARNINGS = 3  # the summary repeats the reader's first warnings


def cautions(results: Results) -> list[str]:
    """Return the cautions of results, those that change their meaning first."""
    found = (
        _of_the_model,
        doubtful_rendering,
        doubtful_verdicts,
        _widened,
        _of_the_data,
        misfits,
        _warnings,
    )
    return [said for cautions_of in found for said in cautions_of(results)]


def _of_the_model(results: Results) -> Iterator[str]:
    """Say what the model leaves out, and where family or accuracy is not the one asked for."""
    for row in results.skipped:
        if row.what.endswith(", in the hierarchical model"):
            yield f"The hierarchical model leaves out {row.what.partition(',')[0]}: {row.why}."
        elif row.what == "Bayesian intervals":
            yield f"There are no Bayesian intervals: {row.why}"
    family = family_of(results)
    for parameter, quantity in results.data.quantities.items():
        rows = matching(results.intervals, parameter=parameter, kind="mean", joint="marginal")
        chosen = distinct(matching(rows, family=family), "environment")
        others = [name for name in distinct(rows, "environment") if name not in chosen]
        if chosen and others:
            yield (
                f"Intervals of {quantity.label} are of the normal family in {listed(others)}, where"
                f" values of zero or below have no logarithm, and of the {family} family in"
                f" {listed(chosen)}."
            )
    gate = results.diagnostics.gate if results.diagnostics else None
    if gate and gate.passed and not gate.tolerance_met:
        yield gate.error_reached


def overruled(results: Results) -> list[str]:
    """Say where the model's mean lies far from that of the data, by its own standard error."""
    rows = matching(results.intervals, kind="mean", joint="marginal", family=family_of(results))
    by_cell = {(row.parameter, row.environment): row for row in matching(rows, method="classical")}
    named = []
    for row in matching(rows, method="bayesian"):
        plain = by_cell.get((row.parameter, row.environment))
        if plain is None:
            continue
        scale = math.log if row.family == "lognormal" else float
        width = scale(plain.upper) - scale(plain.lower)
        shift = abs(scale(row.estimate) - scale(plain.estimate))
        errors = -2.0 * special.stdtrit(plain.n - 1.0, 0.5 * (1.0 - plain.level))
        if errors * shift > _OVERRULED * width > 0.0:
            label = results.data.quantities[row.parameter].label
            shown = Estimated(plain.estimate, plain.lower, plain.upper)
            values = f"{shown.text(row.estimate)} instead of {shown.text(plain.estimate)}"
            named.append(f"{label} of {row.environment} ({f'{values} {row.unit}'.rstrip()})")
    if not named:
        return []
    return [
        "The Bayesian mean lies more than two standard errors from the"
        f" {possessive(results.data.words.subjects)} mean in {listed(named, MOST_SHOWN)}. Use the"
        " classical interval, or wider [model.priors]."
    ]


def _widened(results: Results) -> Iterator[str]:
    """Say where the prior of the spread makes an interval far wider than the data do."""
    # Of several environments each says what the spread of the others may be.
    if len(distinct(results.intervals, "environment")) > 1:
        return
    for pair in matching(results.comparison or (), kind="mean", family=family_of(results)):
        if pair.width_ratio is not None and pair.width_ratio > _WIDENED:
            yield (
                f"The Bayesian interval of {results.data.quantities[pair.parameter].label} in"
                f" {pair.environment} is {short(pair.width_ratio, 2)} times as wide as the"
                f" classical one: {results.data.words.subjects} lie closer together than the prior"
                " expects. Use the classical interval, or lower log_s_mean in [model.priors]."
            )


def _of_the_data(results: Results) -> Iterator[str]:
    """Say what control limits cut off, how few subjects there are, and what may chatter."""
    words = results.data.words
    for name, quantity in results.data.quantities.items():
        rows = matching(results.intervals, parameter=name)
        counts = {row.environment: row.left_out for row in rows if row.left_out}
        if counts:
            where = ", ".join(f"{count} in {place}" for place, count in counts.items())
            yield (
                f"Intervals of {quantity.label} leave out adjustments at the limits of the"
                f" control: {where}."
            )
    subjects = max((row.n for row in results.intervals), default=_FEW)
    if subjects < _FEW:
        yield (
            f"{subjects} {words.subjects} are few: classical limits rest on"
            f" {counted(subjects - 1, 'degree')} of freedom, Bayesian ones largely on the priors."
        )
    unstable = matching(results.rendering or (), coupled=False, verdict="cannot")
    if unstable:
        names = listed([str(row.environment) for row in unstable], MOST_SHOWN)
        yield (
            f"Rendered directly, {names} may chatter with some hands, and {words.users} may then"
            " set them wrongly."
        )


def misfits(results: Results) -> Iterator[str]:
    """Say what the checks of the model found, in the family of the study."""
    checks = results.checks
    if checks is None:
        return
    family = family_of(results)
    rows = matching(checks.normality, family=family)
    # Bonferroni over the cells tested: a study of many cells is not alarmed by chance.
    rejected = [row for row in rows if row.p_value * len(rows) < _REJECTED]
    cells = [f"{row.parameter} in {row.environment}" for row in rejected]
    if cells:
        yield (
            f"Shapiro–Wilk tests reject the {family} family, which classical intervals"
            f" assume, for {listed(cells, MOST_SHOWN)}."
        )
    if checks.loo is None:
        return
    yield from checks.loo.messages
    words = results.data.words
    found = []
    for check in matching(checks.statistics, unusual=True):
        # Where the data have too little of it, most new studies have more.
        side = "low" if check.above > 0.5 else "high"
        what = _UNEXPECTED[check.statistic, side].format(
            subject=words.subject, subjects=words.subjects, quantity=check.parameter
        )
        found.append(f"in {check.environment} {what}")
    if found:
        of_all = f"{len(found)} of {counted(len(checks.statistics), 'check')}"
        yield f"{capitalised('; '.join(found))} than the model expects ({of_all})."


def _warnings(results: Results) -> Iterator[str]:
    """Repeat the reader's first warnings."""
    # What a verdict leans on is said with the verdict.
    leaning = [row for one in results.verdicts if one.leaning for row in one.leaning.rows]
    places = [(row.file, row.row) for row in leaning]
    warnings = [note for note in results.data.doubts if (note.file, note.row) not in places]
    for warning in warnings[:_WARNINGS]:
        where = f"{warning.file}:{warning.row}: " if warning.file else ""
        stop = "" if warning.text.endswith(("?", ".")) else "."
        yield f"{where}{warning.text}{stop}"
    if len(warnings) > _WARNINGS:
        yield f"Data lists {len(warnings) - _WARNINGS} more to look at."
