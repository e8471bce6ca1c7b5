"""What the page says of verdicts: sentences of the summary, cells of its table, and a section."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from percept.boundary.confidence import FEWEST_FOR_PAIR, PARTS
from percept.boundary.feels_real import FEWEST_FOR_MAGNITUDE, judge
from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.numbers import bare, rounded
from percept.report.select import (
    METHOD_NAMES,
    MOST_NAMED,
    Section,
    Words,
    distinct,
    listed,
    matching,
    words_of,
)
from percept.report.sentences import cause_sentences
from percept.results import LadderEffect, MoreSubjects, Rendered, Results, Verdict

__all__ = [
    "RENDERED",
    "coupling_sentences",
    "feeling_sentences",
    "feelings",
    "probability_said",
    "rendering_sentences",
]

#: How an environment is displayed, by whether it is through the coupling.
RENDERED = {False: "directly", True: "through the coupling"}
#: What is said of the environments of a verdict.
_RENDERS = {
    "can": "{} can be rendered with every passive hand",
    "cannot": "with {} some hands make the motion grow",
    "undecided": "for {} the device’s table does not tell",
}
#: Outcomes in the order of a sentence: what is said of one environment, and of several.
_SAID = {
    "feels real": ("{} feels real", "{} feel real"),
    "does not": ("{} does not feel real", "{} do not feel real"),
    "too little data": ("there is too little data on {}", "there is too little data on {}"),
}
#: From here on a probability in whole per cents would be 100.
_ALMOST_CERTAIN = 0.995
_KILO = 1e3  # N/m in kN/m
_INSIDE = ("inside", "marginal", "outside")


def probability_said(probability: float) -> str:
    """Write a probability in whole per cents."""
    if probability > _ALMOST_CERTAIN:
        return "> 99 %"
    if probability < 1.0 - _ALMOST_CERTAIN:
        return "< 1 %"
    return f"{100.0 * probability:.0f} %"


def _said_probability(probability: float, decision: float) -> str:
    """Write a probability in per cent, with the digits that keep it on its side of the decision."""
    outcome = judge(probability, decision)
    for digits in range(2, 6):
        shown = round(probability, digits)
        if judge(shown, decision) == outcome:
            break
    if shown >= 1.0:
        return "> 99 %"
    return f"{100.0 * shown:.6g} %" if shown > 0.0 else "< 1 %"


def feeling_sentences(
    verdicts: Sequence[Verdict], words: Words, effects: Sequence[LadderEffect] = ()
) -> list[str]:
    """Say what feels real, through the coupling where there is one, by which method and level.

    Where the methods disagree, `effects` of the ladder name the cause.
    """
    coupled = bool(matching(verdicts, coupled=True))
    judged = matching(verdicts, coupled=coupled)
    if not judged:
        return []
    groups = []
    for outcome in _SAID:
        with_outcome = matching(judged, outcome=outcome)
        if with_outcome:
            said = _said_of(distinct(with_outcome, "environment"), outcome, len(judged), words)
            probabilities = [verdict.probability for verdict in with_outcome]
            groups.append(f"{said} ({_said_range(probabilities, judged[0].decision)})")
    rendered = "Through the coupling" if coupled else "Displayed directly"
    central = percent(judged[0].central)
    decision = percent(judged[0].decision)
    measures = {"bayesian": "Bayesian probability", "classical": "classical confidence"}
    measure = " or ".join(measures[method] for method in distinct(judged, "method"))
    return [
        f"{rendered}, {'; '.join(groups)}.",
        f"Judged against the central {central} of {words.users}: {measure}, decision at"
        f" {decision}.",
        *_too_few(judged, words),
        *_straddling(judged),
        *_leaning(judged, words),
        *_disagreeing(judged, words, effects),
        *_deciding(judged, words),
    ]


def _said_of(names: Sequence[str], outcome: str, count: int, words: Words) -> str:
    several = len(names) > 1
    if len(names) <= MOST_NAMED:
        named = listed(names)
    elif len(names) == count:
        named = f"all {count} {words.environments}"
    else:
        named = f"{len(names)} of {count} {words.environments}"
    return _SAID[outcome][several].format(named)


def _said_range(probabilities: Sequence[float], decision: float) -> str:
    """Write each probability, or the smallest and the largest of many."""
    if len(probabilities) > MOST_NAMED:
        low = _said_probability(min(probabilities), decision)
        high = _said_probability(max(probabilities), decision)
        return low if low == high else f"{low} to {high}"
    said = [_said_probability(probability, decision) for probability in probabilities]
    return said[0] if len(set(said)) == 1 else listed(said)


def _deciding(judged: Sequence[Verdict], words: Words) -> list[str]:
    """Say how many more subjects would decide what there is too little data on."""
    decisive = {verdict.environment: verdict.more for verdict in judged if verdict.more}
    if not decisive:
        return []
    most = next(iter(decisive.values())).most
    counts = {name: more.subjects for name, more in decisive.items() if more.subjects}
    too_many = [name for name in decisive if name not in counts]
    sentences = []
    if len(counts) > MOST_NAMED:
        fewest, largest = (
            _two_digits(count) for count in (min(counts.values()), max(counts.values()))
        )
        each = f"each of {len(counts)} {words.environments}"
        sentences.append(f"To decide {each}, about {fewest} to {largest} more {words.subjects}.")
    elif counts:
        several = words.subject if set(counts.values()) == {1} else words.subjects
        said = listed([_two_digits(count) for count in counts.values()])
        sentences.append(f"To decide {listed(list(counts))}, about {said} more {several}.")
    if too_many:
        named = listed(too_many)
        if len(too_many) > MOST_NAMED:
            named = f"{len(too_many)} {words.environments}"
        sentences.append(f"{named} would take more than {most:,} {words.subjects}.")
    return sentences


def _two_digits(count: int) -> str:
    return f"{float(f'{count:.2g}'):,.0f}"


def _too_few(judged: Sequence[Verdict], words: Words) -> list[str]:
    """Say where few subjects keep abs(Z_h) from saying that a display does not feel real."""
    held = [
        verdict.environment
        for verdict in judged
        if verdict.outcome == "too little data" and verdict.subjects < FEWEST_FOR_MAGNITUDE
        if judge(verdict.probability, verdict.decision) == "does not"
    ]
    if not held:
        return []
    count = f"fewer than {FEWEST_FOR_MAGNITUDE} {words.subjects}"
    said = f"only k or b can show that {listed(held)} would not feel real"
    return [f"With {count} {said}."]


def _straddling(judged: Sequence[Verdict]) -> list[str]:
    """Say whose Monte Carlo error reaches over a threshold after all draws."""
    sentences = []
    for verdict in judged:
        evidence = verdict.bayesian
        if evidence and evidence.straddles:
            probability = bare(rounded(100.0 * evidence.probability, 3))
            error = bare(rounded(100.0 * evidence.error, 2))
            sentences.append(
                f"The Monte Carlo error of {verdict.environment} ({probability} ± {error} %) still"
                f" reaches over a threshold after {evidence.draws} draws."
            )
    return sentences


def _leaning(judged: Sequence[Verdict], words: Words) -> list[str]:
    """Say which verdicts lean on rows that look mistyped, and what they are without these."""
    sentences = []
    for verdict in judged:
        leaning = verdict.leaning
        if leaning is None:
            continue
        rows = []
        for row in leaning.rows:
            where = "a trial" if row.row is None else f"row {row.row} of {row.file}"
            rows.append(f"{where}: {row.text}")
        without = "that row" if len(rows) == 1 else "those rows"
        said = "there is no verdict"
        other = leaning.without
        if other is not None:
            said = _said_of([other.environment], other.outcome, 1, words)
            said += f" ({_said_probability(other.probability, other.decision)})"
        sentences.append(
            f"The verdict on {verdict.environment} leans on {listed(rows)}. Without {without}"
            f" {said}."
        )
    return sentences


def _disagreeing(
    judged: Sequence[Verdict], words: Words, effects: Sequence[LadderEffect]
) -> list[str]:
    """Say where the classical method comes to another outcome than the Bayesian one, and why."""
    parts = []
    apart: list[str] = []
    for outcome in _SAID:
        names = []
        least = []
        for verdict in judged:
            classical = verdict.classical
            bayesian = verdict.bayesian
            if not classical or not bayesian or bayesian.outcome == outcome:
                continue
            if classical.outcome == outcome:
                names.append(verdict.environment)
                least.append(classical.least)
        if names:
            apart += names
            said = _said_of(names, outcome, len(judged), words)
            # Classical confidences have a threshold of their own for "does not".
            parts.append(f"{said} ({_said_range(least, judged[0].decision)})")
    if not parts:
        return []
    why = cause_sentences(effects, apart, "user", words)
    return [f"The classical method says otherwise: {'; '.join(parts)}.", *why]


def rendering_sentences(results: Results) -> list[str]:
    """Say which environments can be rendered with every passive hand, in which way."""
    rows = [row for row in results.rendering or () if row.environment is not None]
    ways = distinct(rows, "coupled")
    said = {
        way: _said_renders(matching(rows, coupled=way), words_of(results).environments)
        for way in ways
    }
    if len(set(said.values())) < len(said):
        return [f"Directly and through the coupling alike, {said[False]}."]
    return [f"{capitalised(RENDERED[way])}, {text}." for way, text in said.items()]


def _said_renders(rows: list[Rendered], environments: str) -> str:
    parts = []
    for verdict, said in _RENDERS.items():
        names = [str(row.environment) for row in matching(rows, verdict=verdict)]
        if names:
            every = len(names) == len(rows) > 1
            some = listed(names) if len(names) <= MOST_NAMED else f"{len(names)} {environments}"
            parts.append(said.format(f"all {len(names)} {environments}" if every else some))
    return "; ".join(parts)


def coupling_sentences(results: Results) -> list[str]:
    """Say between which stiffnesses couplings are admissible, and where none is."""
    design = results.design
    if design is None:
        return []
    environments = words_of(results).environments
    measure = "probability" if design.method == "bayesian" else "confidence"
    sure = f"with {percent(design.decision)} {measure} or more"
    spans = []
    absent: dict[str, list[str]] = {"none": [], "undecided": []}
    for row in design.environments:
        if row.name is None:
            continue
        if row.softest is None or row.stiffest is None:
            absent["none" if row.outcome == "none" else "undecided"].append(row.name)
            continue
        low = bare(rounded(row.softest.stiffness / _KILO, 2))
        high = bare(rounded(row.stiffest.stiffness / _KILO, 2))
        span = f"{low} kN/m and more" if row.stiffest.bound == "map" else f"{low} to {high} kN/m"
        spans.append(f"{row.name} ({span})")
    said = []
    if spans:
        more = f" and {len(spans) - MOST_NAMED} more" if len(spans) > MOST_NAMED else ""
        said.append(
            f"Couplings that are stable in time feel real in {listed(spans[:MOST_NAMED])}{more}"
            f" {sure}."
        )
    texts = {
        "none": f"No coupling is stable in time and feels real in {{}} {sure}.",
        "undecided": "Whether one is in {} the data do not decide.",
    }
    if not said and not absent["none"]:
        texts["undecided"] = (
            f"Whether a coupling is stable in time and feels real in {{}} {sure}, the data do not"
            " decide."
        )
    for outcome, names in absent.items():
        if names:
            some = listed(names) if len(names) <= MOST_NAMED else f"{len(names)} {environments}"
            said.append(texts[outcome].format(some))
    return said


@dataclasses.dataclass(frozen=True)
class PaperRule:
    """What the rule "curve between curves" says, and by which limits."""

    sentences: str
    method: str
    family: str


@dataclasses.dataclass(frozen=True)
class Feelings:
    """The section on what feels real."""

    bayesian: list[Verdict]
    classical: list[Verdict]
    rendered: dict[bool, str]  # How an environment is displayed, by whether through the coupling
    undecided: MoreSubjects | None  # Of a verdict that more subjects would decide, if there is one
    refuted: float  # A part's confidence that says "does not"
    fewest: int  # Subjects that abs(Z_h) needs
    fewest_refuting: int  # Subjects from which on abs(Z_h) may say "does not"
    paper: PaperRule | None


def feelings(results: Results) -> Section | None:
    """Return the verdicts of both methods, and what the paper's rule says."""
    verdicts = results.verdicts
    if not verdicts:
        return None
    view = Feelings(
        bayesian=[verdict for verdict in verdicts if verdict.bayesian],
        classical=[verdict for verdict in verdicts if verdict.classical],
        rendered=RENDERED,
        undecided=next((verdict.more for verdict in verdicts if verdict.more), None),
        refuted=(1.0 - verdicts[0].decision) / PARTS,
        fewest=FEWEST_FOR_PAIR,
        fewest_refuting=FEWEST_FOR_MAGNITUDE,
        paper=_paper_rule(results),
    )
    return Section("verdicts", "Does it feel real?", view)


def _paper_rule(results: Results) -> PaperRule | None:
    """Return what the rule "curve between curves" says, by the next user's exact envelope."""
    if results.coupling is None:
        return None
    preferred = matching(results.coupling.memberships, kind="user")
    if not preferred:
        return None
    environments = words_of(results).environments
    sentences = []
    for side, rendered in (("uncoupled", RENDERED[False]), ("coupled", RENDERED[True])):
        groups = []
        for inside in _INSIDE:
            agreeing = matching(preferred, **{f"verdict_{side}": inside})
            names = distinct(agreeing, "environment")
            if len(names) > MOST_NAMED:
                groups.append(f"{inside} {len(names)} of {len(preferred)} {environments}")
            elif names:
                groups.append(f"{inside} {listed(names)}")
        sentences.append(f"{capitalised(rendered)}, {'; '.join(groups)}")
    best = preferred[0]
    return PaperRule(". ".join(sentences), METHOD_NAMES[best.method], best.family)
