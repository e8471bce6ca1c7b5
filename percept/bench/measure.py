"""What every part shares: processes of their own, the machine, and a measurement as document and page."""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from percept.errors import RefusalError
from percept.files import FolderFiles, filled_folder
from percept.provenance import Made, made_by
from percept.results.plain import dumps, plain

SCHEMA = "percept-measurement-2"


def python_output(*words: str, timeout: float | None = None, **changes: str) -> str:
    """Run Python in a process of its own, its environment changed; its standard output.

    It keeps percept's modules compiled. Installed packages are compiled as they are installed. A
    checkout would be compiled again at every start where `PYTHONDONTWRITEBYTECODE` is set.
    """
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, *words]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            env=kept | changes,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        raise RefusalError(f"not finished after {timeout:g} s.") from None
    if done.returncode:
        *_, last = ["no message", *done.stderr.strip().splitlines()]
        raise RefusalError(f"{' '.join(words[:3])} failed: {last}")
    return done.stdout


def in_a_process(module: str, task: Any, *, timeout: float | None = None) -> dict[str, Any]:
    """Give a task to a module run as a program, in a process of its own, and return what it prints."""
    output = python_output("-m", module, json.dumps(task), timeout=timeout)
    # Some libraries print to standard output, around the result.
    *_, line = (line for line in output.splitlines() if line.startswith("{"))
    return dict(json.loads(line))


def print_result(result: Mapping[str, Any]) -> None:
    """Print what `in_a_process` returns, on a line of its own."""
    sys.stdout.write(f"\n{json.dumps(result, default=np.ndarray.tolist)}\n")


def machine(loads: tuple[float, float], seconds: float) -> dict[str, Any]:
    """Describe this machine, its load before and after, and how long the measurement took."""
    return {
        "processors": os.cpu_count(), "system": platform.system(), "architecture": platform.machine(),
        "load_before": loads[0], "load_after": loads[1], "seconds": seconds,
    }  # fmt: skip


def described(record: type) -> tuple[str, dict[str, str]]:
    """First line of a record's docstring, and the meaning that annotates each of its fields."""
    hints = get_type_hints(record, include_extras=True)
    about = (record.__doc__ or "").partition("\n")[0]
    return about, {name: hint.__metadata__[0] for name, hint in hints.items()}


def measurement(
    part: str,
    records: Sequence[Any],
    *,
    command: str,
    loads: tuple[float, float],
    seconds: float,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Collect what a part measured; `notes` say what follows from all rows."""
    about, columns = described(type(records[0]))
    document = {
        "schema": SCHEMA,
        "part": part,
        "about": about,
        "columns": [{"names": [name], "meaning": meaning} for name, meaning in columns.items()],
        "made": made_by(command),
        "notes": notes,
        "machine": machine(loads, seconds),
        "rows": [dataclasses.asdict(record) for record in records],
    }
    return dict(plain(document))


def measurement_markdown(document: Mapping[str, Any]) -> str:
    """Write the document as a page."""
    at, names = document["machine"], list(document["rows"][0])
    lines = [
        f"# {document['part'].capitalize()}",
        "",
        document["about"] + ("" if document["part"] == "digits" else " The studies are simulated."),
        "",
        (
            f"{Made(**document['made']).sentence} The run took {at['seconds']:.0f} s on {at['processors']}"
            f" processors ({at['system']}, {at['architecture']}), load {at['load_before']:.1f}"
            f" before and {at['load_after']:.1f} after."
        ),
        *(line for note in document["notes"] for line in ("", note)),
        "",
        "| " + " | ".join(names) + " |",
        "|" + "---|" * len(names),
    ]
    lines += [
        "| " + " | ".join(_cell(row[name]) for name in names) + " |" for row in document["rows"]
    ]
    lines += [
        "",
        *(f"- {', '.join(one['names'])}: {one['meaning']}" for one in document["columns"]),
    ]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_cell, value))
    return str(value).replace("|", "\\|")


def measurement_files(part: str) -> FolderFiles:
    """Return what a part of the benchmark writes."""
    return FolderFiles(f"{part}.md", (f"{part}.md", f"{part}.json"))


def write_measurement(
    document: Mapping[str, Any], out_dir: str | Path, *, force: bool = False
) -> Path:
    """Write the document and its page, named after the part."""
    name = f"{document['part']}.md"
    with filled_folder(out_dir, measurement_files(document["part"]), force=force) as folder:
        (folder / f"{document['part']}.json").write_text(dumps(document), encoding="utf-8")
        (folder / name).write_text(measurement_markdown(document), encoding="utf-8")
    return Path(out_dir) / name
