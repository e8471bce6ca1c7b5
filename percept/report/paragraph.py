"""A paragraph of results to paste into a paper: the numbers of the first screen, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.contrast import contrast_sentences
from percept.report.decisions import feeling_sentences
from percept.report.select import MOST_OPEN, Words, distinct, listed, matching, words_of
from percept.report.sentences import (
    Bias,
    biases_of,
    disagreements,
    ends,
    mean_sentence,
    named_or_counted,
    size_said,
    user_sentences,
)
from percept.results import OverviewRow, Results

__all__ = ["results_paragraph"]

_INTERVALS = {"classical": "CI", "bayesian": "credible interval"}


def results_paragraph(
    results: Results, rows: Sequence[OverviewRow], classical: Sequence[OverviewRow]
) -> str:
    """Write the results as a paragraph.

    Parameters
    ----------
    results : Results
        Of a study.
    rows : sequence of OverviewRow
        Of the first table.
    classical : sequence of OverviewRow
        The same by the classical method alone; their intervals stand beside Bayesian ones.

    Returns
    -------
    str
        Plain text, each number rounded as on the first screen; empty without intervals.
    """
    words = words_of(results)
    sentences = contrast_sentences(results)
    for parameter in distinct(rows, "parameter"):
        label = results.data.quantities[parameter].label
        biases = biases_of(matching(rows, parameter=parameter))
        if biases and not results.data.quantities[parameter].is_matched:
            sentences.append(mean_sentence(biases, label, words))
            continue
        by_classical = biases_of(matching(classical, parameter=parameter))
        others = {other.row.environment: other for other in by_classical}
        sentences += _biases(label, biases, others, words)
        sentences += disagreements(biases, by_classical, words)
    sentences += user_sentences(rows, results.data.quantities, words)
    sentences += feeling_sentences(results.verdicts, results.rendering or (), words)
    if sentences and results.data.simulated:
        sentences.insert(0, "These results are of simulated data.")
    return " ".join(sentences)


def _biases(label: str, biases: Sequence[Bias], others: dict[str, Bias], words: Words) -> list[str]:
    """Say how far one quantity was set off, with the intervals of both methods."""
    name = capitalised(label)
    sentences = []
    clear = [bias for bias in biases if bias.sign]
    said = [_said(bias, others.get(bias.row.environment)) for bias in clear[:MOST_OPEN]]
    if len(clear) > len(said):
        said.append(f"off in {len(clear) - len(said)} more {words.environments}")
    if said:
        sentences.append(f"{name} was {words.verb} {listed(said)}.")
    unclear = [bias for bias in biases if not bias.sign]
    for says_nothing, claim in (
        (False, f"{name} showed no clear bias in"),
        (True, f"These data do not determine the bias of {label} in"),
    ):
        of_case = matching(unclear, says_nothing=says_nothing)
        if of_case:
            names = [bias.row.environment for bias in of_case]
            sentences.append(f"{claim} {named_or_counted(names, len(biases), words)}.")
    return sentences


def _said(bias: Bias, other: Bias | None) -> str:
    """Say the bias in one environment, with its interval and that of the classical method."""
    parts = []
    if other is not None and bias.row.method != "classical":
        level = percent(other.row.level)
        parts.append(f"{level} CI too wide to tell" if other.says_nothing else _interval(other))
    parts.append(_interval(bias))
    side = "too high" if bias.sign > 0 else "too low"
    if not bias.row.reference:
        side = "above zero" if bias.sign > 0 else "below zero"
    return f"{size_said(bias)} {side} in {bias.row.environment} ({'; '.join(parts)})"


def _interval(bias: Bias) -> str:
    return f"{percent(bias.row.level)} {_INTERVALS[bias.row.method]} {ends(bias)}"
