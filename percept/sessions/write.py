"""Sessions to CSV and back: every double in full, every id as it is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from percept.sessions.records import Sessions

_SPECIAL = re.compile(r'[",\r\n]')
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def write_csv(sessions: Sessions, path: str | Path, *, for_spreadsheets: bool = False) -> None:
    """Write the table as UTF-8 CSV, quotes doubled, lines ended by LF."""
    clean = neutralised if for_spreadsheets else str
    table = sessions.table
    if sessions.form == "trials":
        # Columns of a parameter that was not measured would claim that it was.
        pairs = [[f"{p}_ref", f"{p}_adj"] for p in ("k", "b")]
        table = table.drop(columns=[c for pair in pairs if table[pair].isna().all(axis=None) for c in pair])
    columns = [[_cell(value, clean) for value in table[name].tolist()] for name in table.columns]
    header = [_quoted(clean(str(name))) for name in table.columns]
    text = "".join(",".join(record) + "\n" for record in [header, *zip(*columns, strict=True)])
    Path(path).write_bytes(text.encode())


def neutralised(text: str) -> str:
    """Text that a spreadsheet shows and does not run: an apostrophe before what begins a formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def _cell(value: Any, clean: Any) -> str:
    if isinstance(value, float):
        return "" if value != value else repr(value)
    return _quoted(clean(value)) if isinstance(value, str) else str(value)


def _quoted(text: str) -> str:
    # csv.writer leaves a lone carriage return bare when lines end with LF.
    return '"' + text.replace('"', '""') + '"' if _SPECIAL.search(text) else text
