"""What the page says of rendering in time: with which environments no hand makes motion grow."""

from __future__ import annotations

from percept.errors import capitalised
from percept.report.select import MOST_NAMED, distinct, listed, matching, words_of
from percept.results import Rendered, Results

__all__ = ["RENDERED", "rendering_sentences"]

#: How an environment is displayed, by whether it is through the coupling.
RENDERED = {False: "directly", True: "through the coupling"}
#: What is said of the environments of a verdict.
_SAID = {
    "can": "{} can be rendered with every passive hand",
    "cannot": "with {} some hands make the motion grow",
    "undecided": "for {} the device’s table does not tell",
}


def rendering_sentences(results: Results) -> list[str]:
    """Say which environments can be rendered with every passive hand, in which way."""
    rows = [row for row in results.rendering or () if row.environment is not None]
    ways = distinct(rows, "coupled")
    said = {way: _said(matching(rows, coupled=way), words_of(results).environments) for way in ways}
    if len(set(said.values())) < len(said):
        return [f"Directly and through the coupling alike, {said[False]}."]
    return [f"{capitalised(RENDERED[way])}, {text}." for way, text in said.items()]


def _said(rows: list[Rendered], environments: str) -> str:
    parts = []
    for verdict, said in _SAID.items():
        names = [str(row.environment) for row in matching(rows, verdict=verdict)]
        if names:
            every = len(names) == len(rows) > 1
            some = listed(names) if len(names) <= MOST_NAMED else f"{len(names)} {environments}"
            parts.append(said.format(f"all {len(names)} {environments}" if every else some))
    return "; ".join(parts)
