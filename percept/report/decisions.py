"""What can be rendered, what of it feels real, and what to do next: sentences that decide."""

from __future__ import annotations

from collections.abc import Sequence

from percept.boundary.feels_real import FEWEST_FOR_MAGNITUDE, judge
from percept.inference.record import percent
from percept.report.numbers import short
from percept.report.select import METHOD_NAMES, MOST_NAMED, Words, distinct, listed, matching
from percept.report.sentences import cause_sentences
from percept.results import (
    AdmissibleCouplings,
    LadderEffect,
    Rendered,
    Results,
    Verdict,
)

__all__ = [
    "FEELINGS", "RENDERED", "coupling_sentences", "device_sentences", "doubtful_verdicts",
    "feeling_sentences", "judged_verdicts", "paper_rule", "probability_said", "rendered_names",
]  # fmt: skip

#: How an environment is displayed, by whether it is through the coupling.
RENDERED = {False: "directly", True: "through the coupling"}
#: What a verdict is called in a table.
FEELINGS = {
    "feels real": "feels real",
    "does not": "does not feel real",
    "too little data": "not decided",
}
#: Outcomes in the order of a sentence: what is said of one environment, and of several.
_SAID = {
    "feels real": ("{} feels real", "{} feel real"),
    "does not": ("{} does not feel real", "{} do not feel real"),
    "too little data": ("for {} the data do not decide", "for {} the data do not decide"),
}
_ALMOST_CERTAIN = 0.995  # from here on a probability in whole per cents would be 100
_KILO = 1e3  # N/m in kN/m


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


def _named(names: Sequence[str], words: Words, every: int = 0) -> str:
    """Name environments; count many of them."""
    if len(names) <= MOST_NAMED:
        return listed(names)
    return f"{'all ' if len(names) == every else ''}{len(names)} {words.environments}"


def rendered_names(rendering: Sequence[Rendered], verdict: str, *, coupled: bool) -> list[str]:
    """Return the environments of which the device's rendering has this verdict."""
    rows = matching(rendering, coupled=coupled, verdict=verdict)
    return [row.environment for row in rows if row.environment is not None]


def feeling_sentences(
    verdicts: Sequence[Verdict],
    rendering: Sequence[Rendered],
    words: Words,
    effects: Sequence[LadderEffect] = (),
) -> list[str]:
    """Say what can be rendered, what of it feels real by which method, and how many more decide.

    Through the coupling where there is one. Where the methods disagree both are named, and
    `effects` of the ladder name the cause.
    """
    coupled = bool(matching(verdicts, coupled=True) or matching(rendering, coupled=True))
    names = rendered_names(rendering, "can", coupled=coupled)
    judged = judged_verdicts(verdicts, rendering)
    sentences = [_rendered_said(rendering, names, words, coupled=coupled)] if rendering else []
    if judged:
        sentences.append(_felt(judged, words))
        sentences += _disagreeing(judged, words, effects)
        sentences += _deciding(judged, words)
    return sentences


def judged_verdicts(verdicts: Sequence[Verdict], rendering: Sequence[Rendered]) -> list[Verdict]:
    """Return the verdicts on what can be rendered, through the coupling where there is one."""
    coupled = bool(matching(verdicts, coupled=True) or matching(rendering, coupled=True))
    judged = matching(verdicts, coupled=coupled)
    # Without rendering nothing is known against it.
    if not rendering:
        return judged
    names = rendered_names(rendering, "can", coupled=coupled)
    return [verdict for verdict in judged if verdict.environment in names]


def _rendered_said(
    rendering: Sequence[Rendered], names: Sequence[str], words: Words, *, coupled: bool
) -> str:
    """Say which environments can be rendered with every hand."""
    every = [row for row in matching(rendering, coupled=coupled) if row.environment is not None]
    way = "Through this coupling" if coupled else "Displayed directly"
    if len(names) == len(every):
        some = listed(names) if len(names) == 1 else f"all {len(names)} {words.environments}"
    elif names:
        some = f"only {_named(names, words)}"
    elif len(every) == 1:
        some = ""
    else:
        some = f"none of {len(every)} {words.environments}"
    said = f"{some} can be rendered with every hand"
    unknown = rendered_names(rendering, "undecided", coupled=coupled)
    if not some:
        said = f"{every[0].environment} cannot be rendered with every hand"
    if unknown and not names and len(unknown) == len(every):
        return f"{way}, the device’s table does not tell what can be rendered."
    if unknown:
        said += f"; for {_named(unknown, words)} the device’s table does not tell"
    return f"{way}, {said}."


def _felt(judged: Sequence[Verdict], words: Words) -> str:
    """Say which environments feel real, with probabilities and method."""
    groups = []
    for outcome in _SAID:
        of_outcome = matching(judged, outcome=outcome)
        if of_outcome:
            said = _said_of(distinct(of_outcome, "environment"), outcome, len(judged), words)
            probabilities = [verdict.probability for verdict in of_outcome]
            groups.append(f"{said} ({_said_range(probabilities, judged[0].decision)})")
    text = "; ".join(groups)
    return f"{text[0].upper() if text.startswith('for ') else text[0]}{text[1:]}."


def _said_of(names: Sequence[str], outcome: str, every: int, words: Words) -> str:
    return _SAID[outcome][len(names) > 1].format(_named(names, words, every))


def _said_range(probabilities: Sequence[float], decision: float) -> str:
    """Write each probability, or the smallest and the largest of many."""
    if len(probabilities) > MOST_NAMED:
        low = _said_probability(min(probabilities), decision)
        high = _said_probability(max(probabilities), decision)
        return low if low == high else f"{low} to {high}"
    said = [_said_probability(probability, decision) for probability in probabilities]
    return said[0] if len(set(said)) == 1 else listed(said)


def _deciding(judged: Sequence[Verdict], words: Words) -> list[str]:
    """Say how many more subjects would decide what the data do not."""
    needed = {verdict.environment: verdict.more for verdict in judged if verdict.more}
    counts = {name: more.subjects for name, more in needed.items() if more.subjects}
    too_many = [name for name in needed if name not in counts]
    sentences = []
    if len(counts) > MOST_NAMED:
        span = f"{_two_digits(min(counts.values()))} to {_two_digits(max(counts.values()))}"
        each = f"each of {len(counts)} {words.environments}"
        sentences.append(f"To decide {each}, about {span} more {words.subjects}.")
    elif counts:
        several = words.subject if set(counts.values()) == {1} else words.subjects
        said = listed([_two_digits(count) for count in counts.values()])
        sentences.append(f"To decide {listed(list(counts))}, about {said} more {several}.")
    if too_many:
        most = needed[too_many[0]].most
        sentences.append(
            f"{_named(too_many, words)} would take more than {most:,} {words.subjects}."
        )
    return sentences


def _two_digits(count: int) -> str:
    return f"{float(f'{count:.2g}'):,.0f}"


def doubtful_verdicts(verdicts: Sequence[Verdict], words: Words) -> list[str]:
    """Say which verdicts rest on few subjects, on the sampler's luck or on rows that look wrong."""
    sentences = []
    held = [
        verdict.environment
        for verdict in verdicts
        if verdict.outcome == "too little data" and verdict.subjects < FEWEST_FOR_MAGNITUDE
        if judge(verdict.probability, verdict.decision) == "does not"
    ]
    if held:
        sentences.append(
            f"With fewer than {FEWEST_FOR_MAGNITUDE} {words.subjects} only k or b can show that"
            f" {listed(list(dict.fromkeys(held)))} would not feel real."
        )
    for verdict in verdicts:
        evidence = verdict.bayesian
        if evidence and evidence.straddles:
            probability = short(100.0 * evidence.probability)
            error = short(100.0 * evidence.error, 2)
            sentences.append(
                f"The Monte Carlo error of {verdict.environment} {RENDERED[verdict.coupled]}"
                f" ({probability} ± {error} %) still reaches over a threshold after"
                f" {evidence.draws} draws."
            )
        sentences += _leaning(verdict, words)
    return sentences


def _leaning(verdict: Verdict, words: Words) -> list[str]:
    """Say on which doubtful rows a verdict leans, and what it is without these."""
    leaning = verdict.leaning
    if leaning is None:
        return []
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
    return [
        f"The verdict on {verdict.environment} leans on {listed(rows)}. Without {without} {said}."
    ]


def _disagreeing(
    judged: Sequence[Verdict], words: Words, effects: Sequence[LadderEffect]
) -> list[str]:
    """Say where the classical method comes to another outcome than the Bayesian one, and why."""
    parts = []
    apart: list[str] = []
    for outcome in _SAID:
        others = {}
        for verdict in judged:
            if not verdict.classical or not verdict.bayesian:
                continue
            if verdict.classical.outcome == outcome != verdict.bayesian.outcome:
                others[verdict.environment] = verdict.classical.least
        if others:
            apart += others
            said = _said_of(list(others), outcome, len(judged), words)
            # Classical confidences have a threshold of their own for "does not".
            parts.append(f"{said} ({_said_range(list(others.values()), judged[0].decision)})")
    if not parts:
        return []
    why = cause_sentences(effects, apart, "user", words)
    return [f"That is the Bayesian answer; by the classical one {'; '.join(parts)}.", *why]


def device_sentences(results: Results, words: Words) -> list[str]:
    """Say how much damping the device lacks for what it cannot render."""
    rendering = results.rendering or ()
    coupled = bool(matching(rendering, coupled=True))
    names = rendered_names(rendering, "cannot", coupled=coupled)
    damping = results.provenance.scene.get("device", {}).get("damping")
    if not names or damping is None or results.provenance.scene["device"].get("modes"):
        return []
    rows = {row.environment: row for row in matching(rendering, coupled=coupled)}
    needed = [rows[name].needed_damping for name in names]
    said = listed([short(size) for size in needed])
    if len(needed) > MOST_NAMED:
        said = f"{short(min(needed))} to {short(max(needed))}"
    how = "Through this coupling" if coupled else "Displayed directly"
    need = "need" if len(names) > 1 else "needs"
    return [
        f"{how} {_named(names, words)} {need} {said} N·s/m of damping; the device has {damping:g}."
    ]


def coupling_sentences(design: AdmissibleCouplings | None, words: Words) -> list[str]:
    """Say between which stiffnesses couplings are admissible, and where none is."""
    if design is None:
        return []
    measure = "probability" if design.method == "bayesian" else "confidence"
    sure = f"{percent(design.decision)} {measure}"
    spans: list[str] = []
    absent: dict[str, list[str]] = {"none": [], "undecided": []}
    for row in design.environments:
        if row.name is None:
            continue
        if row.softest is None or row.stiffest is None:
            absent["none" if row.outcome == "none" else "undecided"].append(row.name)
            continue
        low = short(row.softest.stiffness / _KILO, 2)
        span = f"{low} kN/m and more"
        if row.stiffest.bound != "map":
            span = f"{low} to {short(row.stiffest.stiffness / _KILO, 2)} kN/m"
        through = "through" if spans else "feels real through couplings of"
        spans.append(f"{row.name} {through} {span}")
    sentences = []
    if spans:
        more = f" and {len(spans) - MOST_NAMED} more" if len(spans) > MOST_NAMED else ""
        sentences.append(f"{listed(spans[:MOST_NAMED])}{more} ({sure}).")
    if names := absent["none"]:
        sentences.append(f"No coupling serves {_named(names, words)}.")
    if names := absent["undecided"]:
        sentences.append(
            f"Whether a coupling makes {_named(names, words)} feel real the data do not decide."
        )
    return sentences


def paper_rule(results: Results, words: Words) -> list[str]:
    """Say what the rule "curve between curves" says, by the next user's exact envelope."""
    memberships = results.coupling.memberships if results.coupling else ()
    rows = matching(memberships, kind="user")
    if not rows:
        return []
    sentences = []
    for side, how in (("uncoupled", RENDERED[False]), ("coupled", RENDERED[True])):
        groups = []
        for inside in ("inside", "marginal", "outside"):
            names = distinct(matching(rows, **{f"verdict_{side}": inside}), "environment")
            if names:
                groups.append(f"{inside} {_named(names, words)}")
        sentences.append(f"{how}, {'; '.join(groups)}")
    by = f"{METHOD_NAMES[rows[0].method]}, {rows[0].family}"
    return [
        "The paper’s rule asks another question: whether the curve of |Z_h| stays between the"
        f" curves of a boundary, which few {words.subjects} make wide. By the next {words.user}’s"
        f" exact envelope ({by}): {'; '.join(sentences)}."
    ]
