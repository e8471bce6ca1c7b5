"""What was read, what was left out, and what a result was made from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from percept.errors import capitalised
from percept.report.sections import Cell, Section, Table, of, table_of
from percept.report.select import words_of
from percept.results import LeftOutRow, Note, Results, plain
from percept.scene import Scene

__all__ = ["data"]


def data(results: Results) -> Section:
    """Return the section of the data and their provenance."""
    words = words_of(results)
    read = results.data
    empty = f"empty cells ({words.subject} × {words.environment})"
    labels = {
        "subjects": words.subjects,
        "environments": words.environments,
        "empty cells (subject × environment)": empty,
    }
    counts = [f"{labels.get(what, what)} {count}" for what, count in read.counts.items()]
    cells = {
        capitalised(words.environment): of("environment"),
        "Quantity": lambda row: f"{row.parameter} ({row.unit})" if row.unit else row.parameter,
        words.subjects: of("n", style="count"),
        "Mean": of("mean"),
        "SD": of("sd"),
    }
    exclusions = table_of(
        "What was left out, and why.",
        read.exclusions,
        {"Who": of("who"), "What": of("what"), "Why": of("why"), "Where": _place},
    )
    sentences = [f"Read: {', '.join(counts)}."] if counts else []
    if not read.exclusions:
        sentences.append("No row was left out.")
    caption = f"Values: {words.subjects}’ means over their trials."
    return Section(
        "data",
        "Data",
        sentences,
        [
            table_of(caption, read.cells, cells),
            exclusions,
            _settings(results),
        ],
        parts=[
            Section("doubts", "To look at; nothing is left out", _notes(read.doubts), form="list"),
            Section("notices", "Choices of the reader", _notes(read.notices), form="list"),
            Section("provenance", "Provenance", list(_provenance(results))),
            Section("skipped", "Not computed", _skipped(results), form="list"),
        ],
        is_folded=True,
    )


def _place(row: LeftOutRow | Note) -> str:
    """Name the file and line of a note."""
    if not row.file:
        return ""
    return row.file if row.row is None else f"{row.file}:{row.row}"


def _notes(notes: Sequence[Note]) -> list[str]:
    return [": ".join(filter(None, (_place(note), note.text))) for note in notes]


def _provenance(results: Results) -> Iterator[str]:
    """Say which versions, seed and files these results are of."""
    made = results.provenance
    versions = ", ".join(f"{name} {version}" for name, version in made.versions.items())
    yield f"Made with {versions}; seed {made.seed}."
    for file in made.files:
        yield f"{file.name}: {file.rows} rows, SHA-256 {file.sha256}."


def _settings(results: Results) -> Table:
    """Return every setting that is not the default."""
    defaults = plain(Scene().to_dict())
    lines: list[list[Cell]] = []
    for table, entries in results.provenance.scene.items():
        usual = defaults.get(table) or {}
        for key, setting in entries.items() if isinstance(entries, Mapping) else ():
            if setting != usual.get(key):
                lines.append([(f"{table}.{key}",), (str(setting),)])
    return Table("The scene, where it differs from the defaults.", ["Key", "Value"], lines)


def _skipped(results: Results) -> list[str]:
    """Say what was not computed of what somebody asked for."""
    scene: Mapping[str, Any] = results.provenance.scene
    jnd = scene.get("study", {}).get("jnd")
    unasked = [
        "" if scene.get("device") else "[device]",
        "" if scene.get("coupling") else "[coupling]",
    ]
    sentences = []
    for row in results.skipped:
        nobody = any(table in row.why for table in unasked)
        if not nobody and (jnd or not row.what.startswith("JND")):
            sentences.append(f"{row.what}: {row.why}.")
    return sentences
