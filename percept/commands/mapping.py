"""Scenes written from data: the mapping that `new --from`, `--accept` and `--write-scene` share."""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from percept.errors import UsageError, printable

if TYPE_CHECKING:
    from percept.scene import Scene
    from percept.sessions import Proposal, ReadOptions

__all__ = ["lacks", "template", "whole_scene", "with_mapping", "write_new"]

#: The line that begins a table of the template, whether it is switched on or not.
_TABLE = re.compile(r"^(?:#: )?\[(\w+)", re.MULTILINE)
_OTHER_KEYS = (
    '# Every other key has its default. To change one, remove the "#:" of it and its table.\n'
)
_Tables = Mapping[str, Any]


def template() -> str:
    """Read the scene that has every key."""
    return resources.files("percept.commands").joinpath("scene.toml").read_text(encoding="utf-8")


def whole_scene(proposal: Proposal, scene_file: str | None) -> str:
    """Write a proposal as a whole scene.

    Below it stand the tables of the analyst's scene, or of the template without one. Where both
    have a key, the analyst's counts.
    """
    if scene_file is None:
        known = tomllib.loads(proposal.text)
        _, *sections = template().split("\n\n")
        kept = [text for text in sections if not _names_one_of(text, {*known, "environments"})]
        off = [f"{_switched_off(text)}\n" for text in kept]
        return "\n".join([proposal.text, _OTHER_KEYS, *off])
    own = tomllib.loads(Path(scene_file).read_text(encoding="utf-8-sig"))
    comments = [line for line in proposal.text.splitlines() if line.startswith("#")]
    return "\n".join([*comments, *_toml(_merged(tomllib.loads(proposal.text), own))]) + "\n"


def _switched_off(text: str) -> str:
    """Make each line of a section of the template one to switch on."""
    lines = text.strip().splitlines()
    return "\n".join(line if line.startswith("#") else f"#: {line}" for line in lines)


def _names_one_of(text: str, tables: set[str]) -> bool:
    """Whether a section of the template is of one of the tables."""
    begins = _TABLE.search(text)
    return begins is not None and begins[1] in tables


def _merged(proposed: _Tables, own: _Tables) -> _Tables:
    """Complete a scene's tables by a proposal's, key by key."""
    tables = dict(own)
    for name, table in proposed.items():
        tables[name] = {**table, **own.get(name, {})}
    return tables


def _toml(tables: _Tables) -> list[str]:
    """Write tables of a scene as TOML: single keys first."""
    from percept.sessions.proposed import toml_text, toml_value

    lines = []
    for name, value in tables.items():
        if not isinstance(value, Mapping):
            lines.append(f"{name} = {toml_value(value)}")
    for name, value in tables.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{name}]"]
            lines += [f"{toml_text(key)} = {toml_value(item)}" for key, item in value.items()]
    return lines


def with_mapping(
    arguments: argparse.Namespace, scene: Scene, options: ReadOptions, error: UsageError
) -> Scene:
    """Propose a mapping of unknown columns; use and write it only where an option says so."""
    from percept.scene import Scene
    from percept.sessions import propose_columns

    proposal = propose_columns(*arguments.sessions, options=options)
    if not proposal.guessed:
        raise error
    if proposal.refused is not None and not proposal.missing:
        first = getattr(proposal.refused, "problems", (proposal.refused,))[0]
        hint = f"{error.hint} percept tried a mapping of its own. Under it: {first}"
        raise UsageError(
            error.message, file=error.file, row=error.row, column=error.column, hint=hint
        ) from error
    written = ""
    if arguments.write_scene:
        write_new(arguments.write_scene, whole_scene(proposal, arguments.scene))
        written = f" It is written to {arguments.write_scene}."
    accepted = arguments.accept or arguments.write_scene
    if accepted and not proposal.missing:
        said = f"notice: columns are read as follows.{written}\n{proposal.text}"
        print(said, file=sys.stderr)
        tables = scene.model_dump(exclude_none=True)
        if scene.quantities == Scene().quantities:
            # Stiffness and damping are what a scene without quantities means, not a part of it.
            del tables["quantities"]
        return scene.with_tables(**_without_defaults(tables, tomllib.loads(proposal.text)))
    hint = (
        "Add --accept to go on with it, or --write-scene scene.toml to write it too."
        " percept new --from writes it alone."
    )
    if written:
        hint = f"{written.strip()} {lacks(proposal)} Then give --scene {arguments.write_scene}."
    elif proposal.missing:
        hint = (
            f"{lacks(proposal)} Add --write-scene scene.toml to write the rest; complete it, and"
            " give --scene scene.toml."
        )
    message = (
        f"the columns have other names. This is what percept would make of them:\n\n{proposal.text}"
    )
    raise UsageError(message, file=str(arguments.sessions[0]), hint=hint) from error


def _without_defaults(tables: _Tables, proposed: _Tables) -> _Tables:
    """Merge a proposal into a scene's tables, which have their defaults."""
    merged = {}
    for name, table in proposed.items():
        own = tables.get(name, {})
        # A scene's columns are its own; every other key of the proposal differs from its default.
        merged[name] = {**table, **own} if name == "columns" else {**own, **table}
    return merged


def write_new(path: str, text: str) -> None:
    """Write a file that is not there yet."""
    hint = "Give another name, or remove it first."
    try:
        with Path(path).open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)
    except FileExistsError as error:
        raise UsageError("is already there and stays as it is.", file=path, hint=hint) from error
    except OSError as error:
        hint = "Name a folder that is there."
        raise UsageError(f"cannot be written: {error.strerror}.", file=path, hint=hint) from error


def lacks(proposal: Proposal) -> str:
    """Say what a scene that was written lacks."""
    if proposal.missing:
        several = len(proposal.missing) > 1
        missing = f"{', '.join(proposal.missing)} {'are' if several else 'is'} missing"
        fill_in = f"fill {'them' if several else 'it'} in"
        if proposal.may_be_means:
            fill_in += ", or uncomment the lines for means where nothing was matched"
        return f"{missing}: {fill_in}."
    if proposal.refused is not None:
        first = getattr(proposal.refused, "problems", (proposal.refused,))[0]
        return f"The files are not read under it yet: {printable(str(first))}"
    return "Look through it."
