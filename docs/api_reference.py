"""Write docs/api.md from signatures and docstrings.

python docs/api_reference.py
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parent / "api.md"
_MARK = "<!-- From here on the page is written by docs/api_reference.py. -->"

#: Modules with the names that users call; all public names where none is listed.
_MODULES: dict[str, tuple[str, ...]] = {
    "percept": (),
    "percept.study.compare": ("compare_studies", "PairComparison"),
    "percept.study.prediction": ("predict", "Prediction"),
    "percept.haptics": (),
    "percept.inference": (),
    "percept.boundary": (),
    "percept.planning": ("Plan", "plan_mean", "plan_user", "plan_share", "plan_equivalent"),
}
#: Classes whose methods and properties are listed too.
_OPEN = {"Scene", "Sessions", "Study"}
#: A record of more fields than this is made by percept: the page gives its name alone.
_MOST_ARGUMENTS = 6


def _first_sentence(value: Any) -> str:
    """Return the first sentence of a docstring, without roles and doubled backticks."""
    text = inspect.getdoc(value) or ""
    paragraph = " ".join(text.partition("\n\n")[0].split())
    sentence = re.split(r"(?<=[.?]) (?=[A-Z])", paragraph)[0]
    sentence = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", sentence)
    return sentence.replace("``", "`").replace("|", "\\|")


def _call(name: str, value: Any) -> str:
    """Return a name with its arguments, without annotations."""
    signature = inspect.signature(value)
    if isinstance(value, type) and (
        issubclass(value, Exception) or len(signature.parameters) > _MOST_ARGUMENTS
    ):
        return name
    bare = [
        parameter.replace(annotation=inspect.Parameter.empty, default=_shown(parameter.default))
        for parameter in signature.parameters.values()
        if parameter.name not in {"self", "cls"}
    ]
    return name + str(inspect.Signature(bare)).replace("Ellipsis", "...")


def _shown(default: Any) -> Any:
    """Return a default as it is written in a call; dots stand for a function or a class."""
    is_class = isinstance(default, type) and default is not inspect.Parameter.empty
    return ... if is_class or inspect.isroutine(default) else default


def _members(owner: type) -> Iterator[tuple[str, Any]]:
    """Yield the public methods and properties that percept defines of a class, as calls."""
    found: dict[str, Any] = {}
    for base in reversed(owner.__mro__):
        if base.__module__.startswith("percept"):
            found |= vars(base)
    for name, value in found.items():
        if name.startswith(("_", "model_")) or not inspect.getdoc(value):
            continue
        if isinstance(value, classmethod | staticmethod) or inspect.isfunction(value):
            function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
            yield _call(f".{name}", function), function
        elif hasattr(value, "__get__") and not isinstance(value, str | int | float):
            yield f".{name}", value


def _table(rows: list[tuple[str, Any]]) -> list[str]:
    """Return a Markdown table of calls and what each gives."""
    return [
        "| name | what it is |",
        "|---|---|",
        *(f"| `{call}` | {_first_sentence(value)} |" for call, value in rows),
    ]


def reference() -> str:
    """Return the page's part that follows from the code."""
    lines: list[str] = []
    for module_name, chosen in _MODULES.items():
        module = importlib.import_module(module_name)
        names = chosen or [name for name in module.__all__ if not name.startswith("__")]
        values = {name: getattr(module, name) for name in names}
        rows = [(_call(name, value), value) for name, value in values.items()]
        lines += ["", f"## {module_name}", "", *_table(rows)]
        for name in sorted(_OPEN & set(values)):
            lines += ["", f"### {name}", "", *_table(list(_members(values[name])))]
    return "\n".join(lines).strip() + "\n"


def page() -> str:
    """Return the page: its own beginning, then the reference."""
    return PAGE.read_text(encoding="utf-8").partition(_MARK)[0] + f"{_MARK}\n\n{reference()}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
