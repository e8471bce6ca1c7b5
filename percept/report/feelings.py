"""What the page says of verdicts: sentences of the summary, cells of its table, and a section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from percept.boundary.feels_real import judge
from percept.inference.record import percent
from percept.report.numbers import bare, rounded
from percept.report.select import (
    METHOD_NAMES,
    METHODS,
    Record,
    Section,
    Words,
    distinct,
    each_by_itself,
    families_of,
    first,
    listed,
    matching,
    pointed,
    words_of,
)

__all__ = ["RENDERED", "feeling_sentences", "feelings"]

#: How an environment is displayed, by whether it is through the coupling.
RENDERED = {False: "directly", True: "through the coupling"}
#: Outcomes in the order of a sentence: what is said of one environment, and of several.
_SAID = {
    "feels real": ("{} feels real", "{} feel real"),
    "does not": ("{} does not feel real", "{} do not feel real"),
    "too little data": ("there is too little data on {}", "there is too little data on {}"),
}
#: More names than this are counted.
_NAMED = 5
_INSIDE = ("inside", "marginal", "outside")


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


def feeling_sentences(verdicts: Sequence[Record], words: Words) -> list[str]:
    """Say what feels real through the coupling, or directly without one, by which method and level."""
    coupled = bool(matching(verdicts, coupled=True))
    judged = matching(verdicts, coupled=coupled)
    if not judged:
        return []
    groups = []
    for outcome in _SAID:
        alike = matching(judged, outcome=outcome)
        if alike:
            probabilities = [row["probability"] for row in alike]
            said = _said_of(alike, outcome, len(judged), words)
            groups.append(f"{said} ({_said_range(probabilities, alike[0]['decision'])})")
    rendered = "Through the coupling" if coupled else "Displayed directly"
    level = percent(judged[0]["level"])
    decision = percent(judged[0]["decision"])
    measures = {"bayesian": "Bayesian probability", "classical": "classical confidence"}
    measure = " or ".join(measures[method] for method in distinct(judged, "method"))
    return [
        f"{rendered}, {'; '.join(groups)}.",
        f"Judged against the central {level} of {words.users}: {measure}, decision at {decision}.",
        *_straddling(judged),
        *_disagreeing(judged, words),
    ]


def _said_of(rows: Sequence[Record], outcome: str, count: int, words: Words) -> str:
    names = [str(row["environment"]) for row in rows]
    several = len(names) > 1
    if len(names) <= _NAMED:
        named = listed(names)
    elif len(names) == count:
        named = f"all {count} {words.environments}"
    else:
        named = f"{len(names)} of {count} {words.environments}"
    return _SAID[outcome][several].format(named)


def _said_range(probabilities: Sequence[float], decision: float) -> str:
    """Write each probability, or the smallest and the largest of many."""
    if len(probabilities) > _NAMED:
        ends = min(probabilities), max(probabilities)
        low, high = (_said_probability(end, decision) for end in ends)
        return low if low == high else f"{low} to {high}"
    said = [_said_probability(probability, decision) for probability in probabilities]
    return said[0] if len(set(said)) == 1 else listed(said)


def _straddling(judged: Sequence[Record]) -> list[str]:
    """Say whose Monte Carlo error reaches over a threshold after all draws."""
    sentences = []
    for row in judged:
        evidence = row["bayesian"]
        if evidence and evidence["straddles"]:
            probability = bare(rounded(100.0 * evidence["probability"], 3))
            error = bare(rounded(100.0 * evidence["error"], 2))
            sentences.append(
                f"The Monte Carlo error of {row['environment']} ({probability} ± {error} %) still"
                f" reaches over a threshold after {evidence['draws']} draws."
            )
    return sentences


def _disagreeing(judged: Sequence[Record], words: Words) -> list[str]:
    """Say where the classical method comes to another outcome than the Bayesian one."""
    parts = []
    differing = [row for row in judged if _differs(row)]
    for outcome in _SAID:
        others = [row for row in differing if row["classical"]["outcome"] == outcome]
        if others:
            least = [row["classical"]["least"] for row in others]
            said = _said_of(others, outcome, len(judged), words)
            # Classical confidences have a threshold of their own for "does not".
            parts.append(f"{said} ({_said_range(least, others[0]['decision'])})")
    return [f"The classical method says otherwise: {'; '.join(parts)}."] if parts else []


def _differs(verdict: Record) -> bool:
    classical, bayesian = verdict["classical"], verdict["bayesian"]
    return bool(classical and bayesian and classical["outcome"] != bayesian["outcome"])


def feelings(document: Record) -> Section | None:
    """Return the verdicts of both methods, and what the paper's rule says."""
    verdicts = pointed(document["verdicts"], "/verdicts")
    if not verdicts:
        return None
    coupling = document["coupling"] or {}
    memberships = pointed(coupling.get("memberships"), "/coupling/memberships")
    values = {
        "bayesian": [_row(row) for row in verdicts if row["bayesian"]],
        "classical": [_row(row) for row in verdicts if row["classical"]],
        "coupled": bool(coupling),
        "level": verdicts[0]["level"],
        "paper": _paper_rule(memberships, document, words_of(document)),
        "summary": document["data"]["form"] == "summary",
    }
    return Section("verdicts", "Does it feel real?", values)


def _row(verdict: dict[str, Any]) -> dict[str, Any]:
    return {**verdict, "rendered": RENDERED[verdict["coupled"]]}


def _paper_rule(
    memberships: Sequence[Record], document: Record, words: Words
) -> Mapping[str, Any] | None:
    """Return what the rule "curve between curves" says, by the next user's exact envelope."""
    envelopes = matching(memberships, kind="user", shape="envelope")
    rows = [row for row in envelopes if each_by_itself(row)]
    best = {"method": METHODS[::-1], "family": families_of(document)}
    chosen = [
        first(matching(rows, environment=name), **best) for name in distinct(rows, "environment")
    ]
    kept = [row for row in chosen if row is not None]
    if not kept:
        return None
    said = []
    for side, rendered in (("uncoupled", RENDERED[False]), ("coupled", RENDERED[True])):
        groups = []
        for inside in _INSIDE:
            alike = [row["environment"] for row in kept if row[f"verdict_{side}"] == inside]
            if len(alike) > _NAMED:
                groups.append(f"{inside} {len(alike)} of {len(kept)} {words.environments}")
            elif alike:
                groups.append(f"{inside} {listed(alike)}")
        said.append(f"{rendered}, {'; '.join(groups)}")
    method = METHOD_NAMES[kept[0]["method"]]
    return {
        "said": ". ".join(text[:1].upper() + text[1:] for text in said),
        "method": method,
        "family": kept[0]["family"],
    }
