"""Records as a notebook shows them; standard library only."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import Any

#: Longer sequences are told by their length.
_MOST = 6


class NotebookRecord:
    """Gives a dataclass `_repr_html_`: its fields, and a sentence of its own as the caption.

    One that is made with ``repr=False`` prints a line per field that was given.
    """

    def __repr__(self) -> str:
        given = {name: value for name, value in vars(self).items() if value is not None}
        lines = [f"  {name}: {_brief(value)}" for name, value in given.items()]
        return "\n".join([type(self).__name__, *lines])

    def _repr_html_(self) -> str:
        caption = getattr(self, "covers", "") or getattr(self, "sentence", "")
        return fields_html(vars(self), caption=caption)


def fields_html(values: Mapping[str, Any], *, caption: str = "") -> str:
    """Lay named values out as a table."""
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{_html(value)}</td></tr>"
        for name, value in values.items()
    )
    above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{above}{rows}</table>"


def _html(value: object) -> str:
    # A table gives None where the notebook is set to show tables as text.
    shown = value._repr_html_() if hasattr(value, "_repr_html_") else None
    return html.escape(_brief(value)) if shown is None else str(shown)


def _brief(value: object) -> str:
    """Write a value in a line: arrays by their shape, long sequences by their length."""
    shape = getattr(value, "shape", ())
    if shape:
        return f"array of shape {' × '.join(map(str, shape))}"
    if isinstance(value, tuple | list) and len(value) > _MOST:
        return f"{len(value)} values"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "–" if value is None else str(value)
