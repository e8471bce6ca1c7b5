"""Environments predicted from the others: the document, and its page in Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from percept.report.document import provenance
from percept.report.plain import plain

if TYPE_CHECKING:
    from percept.study import Study
    from percept.study.prediction import LeftOut

SCHEMA = "percept-leave-one-out/1"


def left_out_document(study: Study, result: LeftOut) -> dict[str, Any]:
    """Build what leave_one_out.json holds."""
    return {
        "schema": SCHEMA,
        "provenance": provenance(study),
        "simulated": study.sessions.simulated,
        "quantities": [study.sessions.quantities[p].model_dump() for p in study.parameters],
        "sentence": result.sentence,
        **plain(result),
    }


def left_out_markdown(document: Mapping[str, Any]) -> str:
    """Write the document as a page."""
    mean = "geometric mean" if document["family"] == "lognormal" else "mean"
    files = ", ".join(file["name"] for file in document["provenance"]["files"])
    lines = [
        "# Each environment predicted from the others",
        "",
        f"{files}, {document['family']} family. {document['sentence']}",
        *(["", "The sessions are simulated."] if document["simulated"] else []),
        "",
        f"| environment | parameter | reference | observed {mean} | predicted, average user | inside | place "
        "| predicted, next user | users inside | extrapolation |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in document["rows"]:
        beyond = row["beyond"]
        cells = [
            _cell(row["environment"]),
            row["parameter"],
            f"{row['reference']:g}",
            f"{row['observed']:.5g}",
            f"{row['lower']:.4g} to {row['upper']:.4g}",
            "yes" if row["inside"] else "no",
            f"{row['place']:.3f}",
            f"{row['user_lower']:.4g} to {row['user_upper']:.4g}",
            f"{row['users_inside']:.1%}",
            f"{abs(beyond):.2g} decades {'above' if beyond > 0 else 'below'}" if beyond else "",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    lines += [f"\nNo prediction of {name}: {why}" for name, why in document["skipped"]]
    return "\n".join([*lines, "", f"{_units(document)}. {_LEGEND}"])


def _units(document: Mapping[str, Any]) -> str:
    """Say the unit of each parameter."""
    return ", ".join(
        f"{q['symbol']} in {q['unit']}" if q["unit"] else q["symbol"] for q in document["quantities"]
    )


def _cell(text: str) -> str:
    """Keep a name within its cell of a table."""
    return " ".join(text.split()).replace("\\", "\\\\").replace("|", "\\|")


_LEGEND = (
    "Place: predictive probability that as many other users have a lower mean; for "
    "published limits even over (0, 1) where the predictions mean what they say. (Users of sessions were "
    "seen in the other environments too: what they have in common there draws their places towards one half, "
    "and the noise of single trials drives them apart.) Users inside: of a population with the observed mean "
    "and SD, the share between the limits of the next user. Extrapolation: how far the reference lies "
    "outside those the model had seen.\n"
)
