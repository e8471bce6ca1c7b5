"""Records as a notebook shows them; standard library only."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Iterable, Mapping
from typing import Any

__all__ = ["NotebookRecord", "fields_html"]

#: Longer sequences are told by their shape or length.
_MOST = 6


class NotebookRecord:
    """Gives a dataclass `_repr_html_`: its fields, and a sentence of its own as the caption.

    One that is made with ``repr=False`` prints a line per field, and leaves arrays out.
    """

    def __repr__(self) -> str:
        lines = [type(self).__name__]
        for field in dataclasses.fields(self):  # type: ignore[arg-type]  # always one
            value = getattr(self, field.name)
            if hasattr(value, "shape") or _is_left_out(field, value):
                continue
            text = _brief(value)
            if isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
                text = f"{len(value)} records {type(value[0]).__name__}"
            lines.append(f"  {field.name}: {text}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        names = [field.name for field in dataclasses.fields(self)]  # type: ignore[arg-type]  # always one
        caption = next(
            (str(said) for name in ("covers", "sentence") if (said := getattr(self, name, None))),
            "",
        )
        return fields_html({name: getattr(self, name) for name in names}, caption=caption)


def fields_html(values: Mapping[str, Any], *, caption: str = "") -> str:
    """Lay named values out as a table."""
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{_html(value)}</td></tr>"
        for name, value in values.items()
    )
    above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{above}{rows}</table>"


def _is_left_out(field: dataclasses.Field[Any], value: object) -> bool:
    """Whether an optional field was not given: it says nothing to a reader."""
    return value is None and field.default is None


def _html(value: object) -> str:
    # A table gives None where the notebook is set to show tables as text.
    shown = value._repr_html_() if hasattr(value, "_repr_html_") else None
    return html.escape(_brief(value)) if shown is None else str(shown)


def _brief(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool | str):
        return str(value)
    if dataclasses.is_dataclass(value):
        fields = [(field, getattr(value, field.name)) for field in dataclasses.fields(value)]
        named = [
            f"{field.name} {_brief(given)}"
            for field, given in fields
            if not _is_left_out(field, given)
        ]
        return f"{type(value).__name__}: {', '.join(named)}"
    shape = getattr(value, "shape", ())
    if isinstance(shape, tuple) and shape and (len(shape) > 1 or shape[0] > _MOST):
        return f"array of shape {' × '.join(str(length) for length in shape)}"
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_brief(one)}" for key, one in value.items())
    if isinstance(value, Iterable) and not isinstance(value, str):
        parts = list(value)
        return (
            ", ".join(_brief(one) for one in parts)
            if len(parts) <= _MOST
            else f"{len(parts)} values"
        )
    return str(value)
