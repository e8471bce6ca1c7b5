"""The answer first: decisions in sentences, a row per environment, and cautions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.biases import Bias, bias_sentences, biases_of, foremost, user_sentences
from percept.report.cautions import cautions, overruled
from percept.report.contrast import contrast_sentences, level_figures
from percept.report.decisions import (
    FEELINGS,
    RENDERED,
    coupling_sentences,
    device_sentence,
    feeling_sentences,
)
from percept.report.display import centrals
from percept.report.methods import who_gave_what
from percept.report.sections import (
    NOTHING,
    Cell,
    Columns,
    Section,
    Table,
    column,
    estimate,
    of,
    table_of,
    value,
)
from percept.report.select import METHOD_NAMES, distinct, first, matching
from percept.results import Findings, Results

_MOST_SENTENCES = 3
_MOST_CAUTIONS = 5  # that stand open


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
    told = [statement for statement in statements if statement]
    return [*overruled(results), *told[:_MOST_SENTENCES]]


def setting_sentences(results: Results) -> list[str]:
    """Say how far users set each quantity off, and where the next user's settings lie."""
    return bias_sentences(results) + user_sentences(results)


def summary(results: Results, found: Findings) -> Section:
    """Return the first screen: decisions, the table of environments, cautions and a figure."""
    shown = foremost(results)
    every = distinct(biases_of(results), "environment")
    others = [name for name in every if name not in shown]
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
                tables=[_environments(results, shown, "overview"), centrals(results)],
            ),
            Section(
                "others",
                f"The other {len(others)} {results.data.words.environments}",
                tables=[_environments(results, others, "overview_other")],
                is_folded=True,
            ),
            Section(
                "cautions",
                "Before you rely on it",
                found.cautions[:_MOST_CAUTIONS],
                parts=[
                    Section(
                        "more-cautions",
                        "More to know",
                        found.cautions[_MOST_CAUTIONS:],
                        form="list",
                        is_folded=True,
                    )
                ],
                form="warning",
            ),
            Section("source", "", [who_gave_what(results)], figures=list(level_figures(results))),
        ],
    )


def _environments(results: Results, names: Sequence[str], name: str) -> Table:
    """Return the table with a row per environment."""
    if not names:
        return Table()
    biases = biases_of(results)
    columns: Columns = {capitalised(results.data.words.environment): str}
    last: Columns = {}
    for parameter, quantity in results.data.quantities.items():
        own = matching(biases, parameter=parameter)
        if not own:
            continue
        unit = f" ({quantity.unit})" if quantity.unit else ""
        if not quantity.is_matched:
            last[f"Mean {quantity.symbol}{unit}"] = column(own, "environment", _bias)
            continue
        reference = column(own, "environment", of("row.reference", style="short"))
        columns[f"Reference {quantity.symbol}{unit}"] = reference
        in_unit = "" if own[0].relative else unit
        last[f"Bias of {quantity.symbol}{in_unit}"] = column(own, "environment", _bias)
    for coupled in distinct(results.rendering or results.verdicts, "coupled"):
        columns[capitalised(RENDERED[coupled])] = _display(results, coupled=coupled)
    return table_of(_caption(results, biases[0]), names, columns | last, name=name, csv="intervals")


def _bias(bias: Bias) -> Cell:
    """Return the cell of a bias; where nothing was matched, of a mean."""
    return estimate(bias, bias.style)


def _display(results: Results, *, coupled: bool) -> Callable[[str], Cell]:
    """Return what makes a cell on rendering, and on feeling real of what can be rendered."""
    verdicts = matching(results.verdicts, coupled=coupled)
    rendering = matching(results.rendering or (), coupled=coupled)

    def cell(name: str) -> Cell:
        rendered = first(matching(rendering, environment=name))
        verdict = first(matching(verdicts, environment=name))
        if rendered is not None and rendered.verdict != "can":
            words = {"cannot": "cannot be rendered", "undecided": "rendering not decided"}
            return (words[rendered.verdict],)
        if verdict is None:
            return ("can be rendered",) if rendered else NOTHING
        return (FEELINGS[verdict.outcome], ", ", *value(verdict.probability, 3, "percent"))

    return cell


def _caption(results: Results, bias: Bias) -> str:
    """Say what the columns are."""
    words = results.data.words
    row = bias.row
    what = f"Bias of the average {words.user}"
    if bias.style == "plain":
        what = f"Mean of all {words.users}"
    method = f"{percent(row.level)}, {METHOD_NAMES[row.method]}, {row.family}"
    said = f"{what}, with its interval ({method})."
    if results.verdicts:
        verdict = results.verdicts[0]
        measure = "probability" if verdict.method == "bayesian" else "confidence"
        said += (
            f" Real: with {percent(verdict.decision)} {METHOD_NAMES[verdict.method]} {measure}"
            f" among the central {percent(verdict.central)} of {words.users} at every ω."
        )
    return said
