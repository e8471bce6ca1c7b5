"""Files to Sessions."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept.errors import UsageError
from percept.sessions.options import ReadOptions
from percept.sessions.records import SUMMARY_COLUMNS, TRIAL_COLUMNS, Sessions, Source

__all__ = ["read_sessions", "sessions_from_frame"]

_TEXT = ("subject", "session", "environment", "parameter")
_MISSING = {"", "nan", "na", "null", "none", "-"}


def read_sessions(
    *paths: str | Path, columns: Mapping[str, Any] | None = None, options: ReadOptions | None = None
) -> Sessions:
    """Read session files into one checked table.

    Parameters
    ----------
    *paths : str or Path
        Files, read in this order.
    columns : mapping, optional
        From canonical column name to the file's own.
    options : ReadOptions, optional
        How to read them.

    Returns
    -------
    Sessions

    Raises
    ------
    UsageError
        Unreadable input, naming file, row, column and value.
    """
    if not paths:
        raise UsageError("no file was given.", hint="Name at least one session file.")
    names = {str(v if isinstance(v, str) else v["name"]): k for k, v in (columns or {}).items()}
    frames, sources, files, rows = [], [], [], []
    for index, path in enumerate(paths):
        try:
            data = Path(path).read_bytes()
        except OSError as error:
            raise UsageError("cannot be read: " + str(error.strerror), file=str(path)) from None
        records = list(csv.reader(io.StringIO(data.decode("utf-8-sig"), newline="")))
        frame = pd.DataFrame(records[1:], columns=[names.get(c.strip(), c.strip()) for c in records[0]])
        sources.append(Source(str(path), hashlib.sha256(data).hexdigest(), len(frame)))
        frames.append(_typed(frame, str(path)))
        files += [index] * len(frame)
        rows += range(2, len(frame) + 2)
    return _checked(pd.concat(frames, ignore_index=True), tuple(sources), files, rows)


def sessions_from_frame(frame: pd.DataFrame, *, options: ReadOptions | None = None) -> Sessions:
    """Build Sessions from a DataFrame; see `Sessions.from_frame`."""
    text = frame.astype(object).where(frame.notna(), "").map(lambda v: v if isinstance(v, str) else repr(v))
    for column in frame.columns:
        text[column] = [
            "" if v is None or (isinstance(v, float) and math.isnan(v)) else str(v)
            for v in frame[column].tolist()
        ]
    typed = _typed(text, "<frame>")
    rows = list(range(2, len(typed) + 2))
    return _checked(typed, (Source("<frame>", "", len(typed)),), [0] * len(typed), rows)


def _typed(frame: pd.DataFrame, file: str) -> pd.DataFrame:
    frame = frame.copy()
    for column in [c for c in (*TRIAL_COLUMNS, *SUMMARY_COLUMNS) if c in frame and c not in _TEXT]:
        values = np.empty(len(frame))
        for i, text in enumerate(frame[column]):
            try:
                values[i] = np.nan if text.strip().lower() in _MISSING else float(text)
            except ValueError:
                raise UsageError("not a number.", file=file, row=i + 2, column=column, value=text) from None
        frame[column] = values
    return frame


def _checked(table: pd.DataFrame, sources: tuple[Source, ...], files: list[int], rows: list[int]) -> Sessions:
    provenance = pd.DataFrame({"file": files, "row": rows})
    form = "summary" if "lower" in table and "parameter" in table else "trials"
    needed = SUMMARY_COLUMNS if form == "summary" else ("subject", "environment")
    for column in needed:
        if column not in table:
            raise UsageError("the column is missing.", file=sources[0].name, column=column)
    if form == "summary":
        table = table[list(SUMMARY_COLUMNS)].astype({"n": int})
        return Sessions(table, "summary", sources, counts={"observations": len(table)}, provenance=provenance)
    if "session" not in table:
        table["session"] = "1"
    if "trial" not in table:
        table["trial"] = 1
    for column in ("k_ref", "b_ref", "k_adj", "b_adj"):
        if column not in table:
            table[column] = np.nan
    table = table[[*TRIAL_COLUMNS, *(c for c in table if c not in TRIAL_COLUMNS)]].astype({"trial": int})
    again = table.duplicated(["subject", "session", "environment", "trial"])
    if again.any():
        at = int(np.argmax(again))
        raise UsageError(
            "a second row for the same subject, session, environment and trial.",
            file=sources[files[at]].name,
            row=rows[at],
        )
    return Sessions(table, "trials", sources, counts={"observations": len(table)}, provenance=provenance)
