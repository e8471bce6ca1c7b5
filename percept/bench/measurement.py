"""What one part of the benchmark measured: a document, and its page in Markdown."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from percept import __version__
from percept.bench.machine import machine
from percept.report.folder import filled_folder
from percept.report.plain import dumps, plain

SCHEMA = "percept-measurement-1"
_PACKAGES = ("numpy", "scipy", "emcee", "pandas")


def measurement(
    part: str,
    records: Sequence[Any],
    *,
    command: str,
    simulated: bool,
    loads: tuple[float, float],
    seconds: float,
) -> dict[str, Any]:
    """Collect what a part measured."""
    about, columns = described(type(records[0]))
    found: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "part": part,
            "about": about,
            "columns": [{"names": names, "meaning": meaning} for names, meaning in columns],
            "command": command,
            "simulated": simulated,
            "machine": machine(loads, seconds),
            "versions": {"percept": __version__}
            | {name: importlib.metadata.version(name) for name in _PACKAGES},
            "rows": [dataclasses.asdict(record) for record in records],
        }
    )
    return found


def described(record: type) -> tuple[str, list[tuple[list[str], str]]]:
    """Read a record's docstring: its first sentence, and the meaning of its attributes, several at a time."""
    text = inspect.getdoc(record) or ""
    columns: list[tuple[list[str], str]] = []
    for line in text.partition("Attributes\n----------\n")[2].splitlines():
        if line.startswith(" "):
            names, meaning = columns[-1]
            columns[-1] = (names, f"{meaning} {line.strip()}".strip())
        elif line:
            columns.append(([name.strip() for name in line.partition(" : ")[0].split(",")], ""))
    return text.partition("\n")[0], columns


def measurement_markdown(document: Mapping[str, Any]) -> str:
    """Write the document as a page."""
    at = document["machine"]
    names = list(document["rows"][0])
    lines = [
        f"# {document['part'].capitalize()}",
        "",
        document["about"] + (" The studies are simulated." if document["simulated"] else ""),
        "",
        f"`{document['command']}`, {at['seconds']:.0f} s on {at['processors']} processors ({at['system']}, "
        f"{at['architecture']}), load {at['load_before']:.1f} before and {at['load_after']:.1f} after; "
        + ", ".join(
            f"{name} {version}" for name, version in ({"Python": at["python"]} | document["versions"]).items()
        )
        + ".",
        "",
        "| " + " | ".join(names) + " |",
        "|" + "---|" * len(names),
    ]
    lines += ["| " + " | ".join(_shown(row[name]) for name in names) + " |" for row in document["rows"]]
    lines += ["", *(f"- {', '.join(one['names'])}: {one['meaning']}" for one in document["columns"])]
    return "\n".join(lines) + "\n"


def _shown(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    return str(value).replace("|", "\\|")


def write_measurement(document: Mapping[str, Any], out_dir: str | Path) -> Path:
    """Write the document and its page, named after the part."""
    name = f"{document['part']}.md"
    with filled_folder(out_dir, last=name) as folder:
        (folder / f"{document['part']}.json").write_text(dumps(document), encoding="utf-8")
        (folder / name).write_text(measurement_markdown(document), encoding="utf-8")
    return Path(out_dir) / name
