"""What every part shares: processes of their own, the machine, and the written measurement."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, get_type_hints

import numpy as np

from percept.errors import RefusalError
from percept.provenance import Made, made_by, markdown_table
from percept.results.plain import dumps, plain
from reports.command import write_page

_SCHEMA = "percept-measurement-2"
#: What a process prints: a JSON object.
Printed: TypeAlias = dict[str, Any]


def python_output(*words: str, timeout: float | None = None, **changes: str) -> str:
    """Run Python in a process of its own.

    The process keeps percept's modules compiled. Installed packages are compiled as they are
    installed. A checkout would be compiled again at every start where `PYTHONDONTWRITEBYTECODE` is
    set.

    Parameters
    ----------
    *words : str
        Arguments of Python.
    timeout : float, optional
        Seconds after which the process is ended.
    **changes : str
        Variables of its environment that differ from this process's.

    Returns
    -------
    str
        Its standard output.

    Raises
    ------
    RefusalError
        Where it fails, with its last line, or does not end in time.
    """
    environment = os.environ | changes
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [sys.executable, *words]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, env=environment, timeout=timeout
        )
    except subprocess.TimeoutExpired:
        raise RefusalError(f"not finished after {timeout:g} s.") from None
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise RefusalError(f"{' '.join(words[:3])} failed: {lines[-1]}")
    return done.stdout


def in_a_process(module: str, task: object, *, timeout: float | None = None) -> Printed:
    """Give a task to a module run as a program in a new process, and return what it prints."""
    output = python_output("-m", module, json.dumps(task), timeout=timeout)
    # Some libraries print to standard output, around the result.
    results = [line for line in output.splitlines() if line.startswith("{")]
    return dict(json.loads(results[-1]))


def processor_seconds() -> float:
    """Return processor seconds of this process and of those it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def print_result(result: Mapping[str, object]) -> None:
    """Print what `in_a_process` returns, on a line of its own."""
    sys.stdout.write(f"\n{json.dumps(result, default=np.ndarray.tolist)}\n")


@dataclass(frozen=True)
class Machine:
    """The machine a measurement was made on, and its load."""

    processors: int | None
    system: str
    architecture: str
    load_before: float
    load_after: float
    seconds: float  # That the measurement took


def machine(loads: tuple[float, float], seconds: float) -> Machine:
    """Describe this machine, its load before and after, and how long the measurement took."""
    return Machine(os.cpu_count(), platform.system(), platform.machine(), *loads, seconds)


@dataclass(frozen=True)
class Column:
    """Fields of a row, and what they mean."""

    names: list[str]
    meaning: str


@dataclass(frozen=True)
class Measurement:
    """What a part measured, as its JSON file holds it."""

    schema: str
    part: str
    about: str
    columns: list[Column]
    made: Made
    notes: list[str]  # What follows from all rows
    machine: Machine
    rows: list[dict[str, object]]


def described(record: type) -> tuple[str, list[Column]]:
    """Return the first line of a record's docstring, and the meaning that annotates each field."""
    hints = get_type_hints(record, include_extras=True)
    about = (record.__doc__ or "").partition("\n")[0]
    return about, [Column([name], hint.__metadata__[0]) for name, hint in hints.items()]


def measurement(
    part: str,
    records: Sequence[Any],
    *,
    command: str,
    loads: tuple[float, float],
    seconds: float,
    notes: Sequence[str] = (),
) -> Measurement:
    """Collect what a part measured.

    Parameters
    ----------
    part : str
        Its name.
    records : sequence of dataclasses
        One for each row. Every field is annotated with its meaning.
    command : str
        What was typed.
    loads : pair of float
        Load of the machine before and after.
    seconds : float
        That the run took.
    notes : sequence of str, optional
        What follows from all rows.

    Returns
    -------
    Measurement
        As its JSON file holds it.
    """
    about, columns = described(type(records[0]))
    rows = [plain(record) for record in records]
    described_machine = machine(loads, seconds)
    made = made_by(command)
    return Measurement(_SCHEMA, part, about, columns, made, list(notes), described_machine, rows)


def measurement_markdown(document: Measurement) -> str:
    """Write the document as a page."""
    at = document.machine
    run = (
        f"The run took {at.seconds:.0f} s on {at.processors} processors ({at.system},"
        f" {at.architecture}), load {at.load_before:.1f} before and {at.load_after:.1f} after."
    )
    lines = [f"# {document.part.capitalize()}", "", document.about]
    lines += ["", f"{document.made.sentence} {run}"]
    for note in document.notes:
        lines += ["", note]
    names = list(document.rows[0])
    cells = [[_cell(row[name]) for name in names] for row in document.rows]
    lines += ["", markdown_table(names, cells)]
    for column in document.columns:
        lines.append(f"- {', '.join(column.names)}: {column.meaning}")
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_cell, value))
    return str(value).replace("|", "\\|")


def write_measurement(document: Measurement, folder: Path) -> None:
    """Write the document and its page, named after the part."""
    write_page(folder / f"{document.part}.json", dumps(plain(document)))
    write_page(folder / f"{document.part}.md", measurement_markdown(document))
