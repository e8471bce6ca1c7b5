"""Write docs/scene.md from the scene's schema and from the comments of `percept new`.

python docs/scene_reference.py
"""

from __future__ import annotations

import json
import re
import sys
from importlib import resources
from pathlib import Path
from typing import Any

from percept.scene import Scene

PAGE = Path(__file__).parent / "scene.md"
_MARK = "<!-- From here on the page is written by docs/scene_reference.py. -->"
_TABLE = re.compile(r"(?:#: )?\[([\w.]+)\] *(?:# *(.*))?")
_KEY = re.compile(r"(?:#: )?(\w+) = (.*)")
_LIMITS = {
    "exclusiveMinimum": "> {:g}",
    "minimum": "≥ {:g}",
    "exclusiveMaximum": "< {:g}",
    "maximum": "≤ {:g}",
}
_FIELDS = re.compile(r"^(\w+(?:, \w+)*) : .*\n((?:    .*(?:\n|$))+)", re.MULTILINE)

#: Heads of the tables inside tables.
_TITLES = {
    "DevicePosteriorTable": "A posterior of the device",
    "ModeTable": "A mode",
    "VelocityFilterTable": "A velocity filter",
    "Quantity": "A quantity",
    "ColumnRule": "A column",
    "ExcludeRule": "A rule of exclude",
}


def meanings(template: str) -> dict[str, str]:
    """Return the comment of every table and key of the commented scene."""
    found: dict[str, str] = {}
    table = last = ""
    for line in template.splitlines():
        if head := _TABLE.fullmatch(line):
            table = last = head[1]
            found[table] = head[2] or ""
        elif key := _KEY.fullmatch(line):
            last = f"{table}.{key[1]}"
            found[last] = _comment(key[2])
        elif line.startswith(" ") and last:
            found[last] += " " + line.strip().removeprefix("# ")
    return found


def _comment(rest: str) -> str:
    """Return what follows a value: its comment, or of a key without one the value itself."""
    value, _, comment = re.sub(r'"[^"]*"', lambda text: text[0].replace("#", "\0"), rest).partition(
        " #"
    )
    return (comment.strip() or f"such as `{value.strip()}`").replace("\0", "#")


def value_of(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    """Say in words what values a key takes."""
    if "anyOf" in schema:
        kinds = [
            value_of(part, definitions) for part in schema["anyOf"] if part.get("type") != "null"
        ]
        return " or ".join(dict.fromkeys(kinds))
    if "$ref" in schema:
        return "a table"
    if "enum" in schema:
        return ", ".join(f'`"{choice}"`' for choice in schema["enum"])
    if "const" in schema:
        return f'`"{schema["const"]}"`'
    kind = schema.get("type")
    if kind in {"number", "integer"}:
        word = {"number": "number", "integer": "whole number"}[kind]
        return ", ".join(
            [word, *(text.format(schema[key]) for key, text in _LIMITS.items() if key in schema)]
        )
    if kind == "array" and "prefixItems" in schema:
        numbers = schema["prefixItems"][0]["type"] == "number"
        return "two numbers" if numbers else "one text or two"
    if kind == "array":
        items = schema["items"]
        return f"list: {value_of(items, definitions)}"
    return {"boolean": "`true`, `false`", "string": "text", "object": "a table"}.get(
        str(kind), "any"
    )


def _default(schema: dict[str, Any], *, needed: bool) -> str:
    if needed:
        return "needed"
    default = schema.get("default")
    return (
        "" if default in (None, [], {}, "") or isinstance(default, dict) else f"`{_toml(default)}`"
    )


def _toml(value: Any) -> str:
    """Write a default as TOML does."""
    return json.dumps(value, ensure_ascii=False)


def _rows(table: dict[str, Any], said: dict[str, str], definitions: dict[str, Any]) -> list[str]:
    """Return a Markdown table of a table's keys."""
    rows = (
        ["| key | value | default | meaning |", "|---|---|---|---|"] if table["properties"] else []
    )
    for key, schema in table["properties"].items():
        cells = (
            f"`{key}`",
            value_of(schema, definitions),
            _default(schema, needed=key in table.get("required", ())),
            said.get(key, ""),
        )
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return rows


def _described(table: dict[str, Any]) -> dict[str, str]:
    """Return what the docstring of a table says of its fields."""
    return {
        name: " ".join(text.split())
        for names, text in _FIELDS.findall(table.get("description", ""))
        for name in names.split(", ")
    }


def _said(table: dict[str, Any]) -> list[str]:
    """Return the description of a table without the lists of its fields."""
    text = re.split(r"\n\n(?:Attributes|Parameters|Raises)\n-+\n", table.get("description", ""))[0]
    return [text]


def _links(schema: Any) -> list[str]:
    """Name the definitions that a schema refers to."""
    return re.findall(r'"#/\$defs/(\w+)"', json.dumps(schema))


def reference() -> str:
    """Return the page's part that follows from the code."""
    template = (
        resources.files("percept.commands").joinpath("scene.toml").read_text(encoding="utf-8")
    )
    said = meanings(template)
    schema = Scene.model_json_schema()
    definitions = schema["$defs"]
    lines: list[str] = []
    for name in (name for name in said if name in schema["properties"]):
        field = schema["properties"][name]
        lines += ["", f"## [{name}]", ""]
        inner = _links(field)
        if field.get("type") == "object":
            lines += [f"{said[name][:1].upper()}{said[name][1:]}.", "", *_examples(name, template)]
        else:
            table = definitions[inner.pop(0)]
            own = {
                key.rpartition(".")[2]: text
                for key, text in said.items()
                if key.startswith(f"{name}.")
            }
            lines += [*_said(table), "", *_rows(table, own, definitions)]
            inner += _links(table["properties"])
        if name == "model":
            lines += ["", "### [model.priors]", "", *_examples("model.priors", template)]
        for link in inner:
            table = definitions[link]
            lines += ["", f"### {_TITLES[link]}", "", *_said(table), ""]
            lines += _rows(table, _described(table), definitions)
    return "\n".join(lines).strip() + "\n"


def _examples(name: str, template: str) -> list[str]:
    """Return a table's own lines of the commented scene."""
    block = re.search(
        rf"^((?:#: )?\[{re.escape(name)}\].*?)(?:\n\n|\Z)", template, re.DOTALL | re.MULTILINE
    )
    lines = [] if block is None else block[1].rstrip().splitlines()
    return ["```toml", *(line.removeprefix("#: ") for line in lines), "```"]


def page() -> str:
    """Return the page: its own beginning, then the reference."""
    return PAGE.read_text(encoding="utf-8").partition(_MARK)[0] + f"{_MARK}\n\n{reference()}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
