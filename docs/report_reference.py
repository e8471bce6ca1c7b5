"""Write docs/report.md from the records of `percept.results` and the comments beside their fields.

python docs/report_reference.py
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import sys
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from percept import results
from percept.results import Results

PAGE = Path(__file__).parent / "report.md"
_MARK = "<!-- From here on the page is written by docs/report_reference.py. -->"


def _comments(record: type) -> dict[str, str]:
    """Return the comment behind each field, or the one above it."""
    lines = inspect.getsource(record).splitlines()
    found = {}
    for node in ast.parse(inspect.cleandoc("\n".join(lines))).body[0].body:  # type: ignore[attr-defined]
        if not isinstance(node, ast.AnnAssign):
            continue
        _, _, behind = lines[(node.end_lineno or 1) - 1].partition("  # ")
        above: list[str] = []
        number = node.lineno - 2
        while not behind and lines[number].strip().startswith("#"):
            above.insert(0, lines[number].strip().lstrip("#: "))
            number -= 1
        found[ast.unparse(node.target)] = behind or " ".join(above)
    return found


def _type(annotation: Any) -> str:
    """Return a field's type as JSON holds it, records by their names."""
    text = str(annotation).replace("ForwardRef", "").replace("typing.", "")
    if isinstance(annotation, type):
        text = annotation.__name__
    text = re.sub(r"Annotated\[.*?Validator.*?\)\]", "list: number", text)
    text = re.sub(r"<class '([\w.]+)'>", r"\1", text)
    text = re.sub(r"[a-z_]+(?:\.[a-z_]+)*\.([A-Z])", r"\1", text)
    text = re.sub(r"Literal\[(.*?)\]", lambda found: found[1].replace("'", "`"), text)
    words = {"None": "null", "str": "text", "bool": "true or false", "NoneType": "null"}
    words |= {"float": "number", "int": "whole number", "Mapping": "object", "dict": "object"}
    words["tuple"] = "list"
    for name, word in words.items():
        text = re.sub(rf"\b{name}\b", word, text)
    text = re.sub(r"list\[([^\[\]]*), \.\.\.\]", r"list: \1", text)
    return text.replace("|", "or").replace("'", "").replace("  ", " ")


def _records(record: type) -> Iterator[type]:
    """Yield a record, and the records that its fields hold, each once."""
    waiting = [record]
    seen: set[type] = set()
    while waiting:
        one = waiting.pop(0)
        if one in seen:
            continue
        seen.add(one)
        yield one
        for hint in typing.get_type_hints(one).values():
            for part in _parts(hint):
                if isinstance(part, type) and dataclasses.is_dataclass(part):
                    waiting.append(part)


def _parts(hint: Any) -> Iterator[Any]:
    yield hint
    for part in typing.get_args(hint):
        yield from _parts(part)


def _table(record: type) -> list[str]:
    """Return a Markdown table of a record's fields."""
    comments: dict[str, str] = {}
    for base in reversed(record.__mro__):
        if dataclasses.is_dataclass(base):
            comments |= _comments(base)
    hints = typing.get_type_hints(record)
    rows = ["| field | what it is | type |", "|---|---|---|"]
    for field in dataclasses.fields(record):
        meaning = comments.get(field.name, "").replace("|", "\\|")
        rows.append(f"| `{field.name}` | {meaning} | {_type(hints[field.name])} |")
    return rows


def reference() -> str:
    """Return the page's part that follows from the code."""
    lines: list[str] = []
    for record in _records(Results):
        head = "The document" if record is Results else record.__name__
        summary = (inspect.getdoc(record) or "").partition("\n\n")[0].replace("\n", " ")
        lines += ["", f"## {head}", "", summary, "", *_table(record)]
    return "\n".join(lines).strip() + "\n"


def page() -> str:
    """Return the page: its own beginning, then the reference."""
    beginning = PAGE.read_text(encoding="utf-8").partition(_MARK)[0]
    return f"{beginning}{_MARK}\n\nThe schema is `{results.SCHEMA}`.\n\n{reference()}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
