"""What was read, what was left out, and what a result was made from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from percept.errors import capitalised
from percept.report.sections import Cell, Columns, Section, Table, column, of, table_of
from percept.report.select import distinct, matching
from percept.results import LeftOutRow, Note, Results, plain
from percept.scene import Scene


def data(results: Results) -> Section:
    """Return the section of the data and their provenance."""
    words = results.data.words
    read = results.data
    labels = {
        "subjects": words.subjects,
        "environments": words.environments,
        "empty cells (subject × environment)": (
            f"empty cells ({words.subject} × {words.environment})"
        ),
    }
    counts = [f"{labels.get(what, what)} {count}" for what, count in read.counts.items()]
    cells: Columns = {capitalised(words.environment): str}
    for name in distinct(read.cells, "parameter"):
        own = matching(read.cells, parameter=name)
        unit = f" ({own[0].unit})" if own[0].unit else ""
        cells[f"{name}, {words.subjects}"] = column(own, "environment", of("n", style="count"))
        cells[f"{name}, mean{unit}"] = column(own, "environment", of("mean"))
        cells[f"{name}, SD{unit}"] = column(own, "environment", of("sd"))
    left_out: Columns = {
        "Who": of("who"),
        "What": of("what"),
        "Why": of("why"),
        "Where": _place,
    }
    caption = f"Values: {words.subjects}’ means over their trials."
    sentences = [f"Read: {', '.join(counts)}."] if counts else []
    if not read.exclusions:
        sentences.append("No row was left out.")
    return Section(
        "data",
        "Data",
        [" ".join(sentences)],
        [
            table_of(caption, distinct(read.cells, "environment"), cells, csv="data"),
            table_of("What was left out, and why.", read.exclusions, left_out),
            _settings(results),
        ],
        parts=[
            Section("doubts", "To look at; nothing is left out", _notes(read.doubts), form="list"),
            Section("notices", "Choices of the reader", _notes(read.notices), form="list"),
            Section("provenance", "Provenance", [" ".join(_provenance(results))]),
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
            if setting and setting != usual.get(key):
                lines.append([(f"{table}.{key}",), (str(setting),)])
    return Table("The scene, where it differs from the defaults.", ["Key", "Value"], lines)


def _skipped(results: Results) -> list[str]:
    """Say what was not computed of what somebody asked for."""
    scene = results.provenance.scene
    unasked = [f"[{table}]" for table in ("device", "coupling") if not scene.get(table)]
    has_jnd = bool((scene.get("study") or {}).get("jnd"))
    sentences = []
    for row in results.skipped:
        is_asked = has_jnd or not row.what.startswith("JND")
        if is_asked and not any(table in row.why for table in unasked):
            sentences.append(f"{row.what}: {row.why}.")
    return sentences
