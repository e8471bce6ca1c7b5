"""A cell's text to its value: numbers with one decimal mark per file, JSON paths, and names."""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from percept.sessions.records import Found, clip

Mark = Literal[".", ","]

#: Numbers lie between these in size, or are zero: products of three of them are doubles still.
LEAST = 1e-100
LARGEST = 1e100

#: Texts that say there is no value, in any case; a scene may add some.
MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "."})
SPACE = " \t\xa0"
#: Patterns of plain numbers, by their decimal mark.
_NUMBER = {
    ".": r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?",
    ",": r"[+-]?(?:[0-9]+(?:,[0-9]*)?|,[0-9]+)(?:[eE][+-]?[0-9]+)?",
}
# "1,286" is 1.286 with a decimal comma and 1286 with a comma between thousands; "0,435" and "12,5"
# are not.
_TWO_READINGS = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")
_WORDS = {".": "point", ",": "comma"}
_OTHER: dict[Mark, Mark] = {".": ",", ",": "."}
_NUMPY = re.compile(r"np\.(?:float|int)\d+\(([^()]*)\)")
#: What else stands in cells of numbers: a pattern, what is wrong, and what to do beside correcting
#: it. COLUMN stands for the column's name in the file, CANONICAL for percept's.
_NO_NUMBERS = (
    (
        r"[+-]?[0-9]{1,3}([,.'\s][0-9]{3})+([.,][0-9]*)?",
        "not a plain number: separators of thousands are not read.",
        "Write it without them.",
    ),
    (
        r"(?s:[\[{].*)",
        "a list or a record, not a number.",
        'Say which value counts, such as the last: [columns] k_adj = { name = "…", path = "-1" }.',
    ),
    (
        r"(?s:=.*)",
        "a formula without its result, not a number.",
        "Open the workbook in Excel or LibreOffice, save it there, and read it again.",
    ),
    (
        r"[0-9]{1,2}[-./ ]+[^\W\d_]{3,}[0-9 .]*|[0-9]{4}(-[0-9]{2}){2}.*|([0-9]+[./]){2}[0-9]+",
        "a date, not a number.",
        "Spreadsheets make dates of numbers such as 1.5: import the column as text.",
    ),
    (r"(?s:.*%)", "a percentage, not a number.", "Write it as a fraction, 0.95 for 95%."),
    (
        r"[\u2010-\u2015\u2212] *[0-9.,]+.*",
        "a typographic minus sign, not a number.",
        "Replace it by a hyphen in the whole file.",
    ),
    (
        r"(?i:n\.?/?a\.?|#n/a!?|\.+|\?+|--+|missing)",
        "a word for a missing value, not a number.",
        'Leave the cell empty, or say so in the scene: [sessions] missing = ["CELL"].',
    ),
    (
        r"[+-]?[0-9.,]+ ?[A-Za-z°µΩ].*",
        "a number with a unit or a remark, not a number alone.",
        "Write the number alone, and its unit in the scene, such as [columns] CANONICAL = { name ="
        ' "COLUMN", unit = "UNIT" }.',
    ),
    (r"(?i:[+-]?inf(inity)?)", "not a finite number.", ""),
)
_ZERO_WIDTH = re.compile("[\u200b-\u200f\u2060\ufeff\u00ad]")


def is_missing(cell: str) -> bool:
    """Whether a cell says there is no value."""
    return cell.strip(SPACE).lower() in MISSING


def decimal_mark(columns: Mapping[Any, pd.Series[str]], delimiter: str) -> tuple[Mark, list[Found]]:
    """Find the decimal mark of a file from all its cells of numbers that are used.

    Where every cell has two readings the scene has to say. So it has where semicolons separate the
    cells, which a country with decimal commas has, and points may separate thousands.
    """
    cells: dict[Mark, list[tuple[Any, int, str]]] = {",": list(_marked(",", columns)), ".": []}
    if cells[","] or delimiter == ";":
        cells["."] = list(_marked(".", columns))
    # A mark that cannot separate thousands goes before more numerous ones that can.
    one_reading = {
        sign: sum(_TWO_READINGS.fullmatch(cell) is None for _, _, cell in marked)
        for sign, marked in cells.items()
    }
    mark = max(cells, key=lambda sign: (one_reading[sign], len(cells[sign]), sign == "."))
    if all(cells.values()) or one_reading[mark]:
        return mark, []
    hint = (
        f'Declare [sessions] decimal = "{mark}". If the {_WORDS[mark]} separates thousands, write'
        f' them without it and declare decimal = "{_OTHER[mark]}".'
    )
    return mark, [
        Found(f"{_readings(cell)}.", column, row, cell, hint) for column, row, cell in cells[mark]
    ]


def _marked(sign: Mark, columns: Mapping[Any, pd.Series[str]]) -> Iterator[tuple[Any, int, str]]:
    """Give the column, row and text of each number that has a mark."""
    for column, cells in columns.items():
        for row, cell in cells[cells.str.contains(sign, regex=False)].items():
            text = cell.strip(SPACE)
            if re.fullmatch(_NUMBER[sign], text):
                yield column, int(str(row)), text


def _readings(cell: str) -> str:
    return f"can be read as {cell.replace(',', '.')} or as {re.sub('[.,]', '', cell)}"


def parse_numbers(
    column: Any, series: pd.Series[str], mark: Mark, marks: Collection[str]
) -> tuple[npt.NDArray[np.float64], list[Found]]:
    """Convert cells to numbers, NaN where there is no value; tell what is neither."""
    texts = series.str.strip(SPACE)
    is_number = texts.str.fullmatch(_NUMBER[mark]).to_numpy(dtype=bool)
    plain = texts.where(is_number, "nan").str.replace(",", ".", regex=False)
    numbers = plain.to_numpy(dtype=object).astype(float)
    sizes = np.abs(numbers)
    # A zero with other digits was a number below the least double.
    is_zero = (sizes == 0) & ~texts.str.match("[^eE]*[1-9]").to_numpy(dtype=bool)
    in_range = is_zero | ((sizes >= LEAST) & (sizes <= LARGEST))
    is_missing = texts.str.lower().isin(marks).to_numpy(dtype=bool)
    found = []
    for at in np.flatnonzero(~np.where(is_number, in_range, is_missing)).tolist():
        message = f"not between {LEAST:g} and {LARGEST:g} in size."
        hint = ""
        if not is_number[at]:
            message, hint = _diagnosis(texts.iloc[at], mark)
        found.append(Found(message, column, int(series.index[at]), series.iloc[at], hint))
    return numbers, found


def _diagnosis(text: str, mark: Mark) -> tuple[str, str]:
    """Say what is wrong with a cell that is no number, and what to do about it."""
    other = _OTHER[mark]
    if re.fullmatch(_NUMBER[other], text):
        what = _readings(text) if _TWO_READINGS.fullmatch(text) else f"a decimal {_WORDS[other]}"
        hint = (
            f"Write it with a decimal {_WORDS[mark]}, and thousands without a separator, or set"
            " [sessions] decimal."
        )
        return f"{what}; the file is read with the decimal mark {mark!r}.", hint
    unit = re.sub("^[-+]?[0-9.,]*", "", text).strip()
    for pattern, what, hint in _NO_NUMBERS:
        if re.fullmatch(pattern, text):
            return what, hint.replace("CELL", clip(text)).replace("UNIT", unit)
    return "not a number.", ""


def pick(cell: str, path: str) -> str | None:
    """Pick a value from a JSON cell, as text with all digits; None if a record lacks a key."""
    if is_missing(cell):
        return ""
    text = _NUMPY.sub(r"\1", cell)
    try:
        value = loaded_json(text)
    except (json.JSONDecodeError, RecursionError):
        raise ValueError("not a JSON record or list") from None
    for step in path.split("."):
        if isinstance(value, dict) and step not in value:
            return None
        if value is None:
            break
        try:
            value = value[int(step)] if isinstance(value, list) else value[step]
        except (LookupError, TypeError, ValueError):
            raise ValueError(f"there is no {step!r} in it") from None
    if value is not None and not isinstance(value, str):
        raise ValueError(f"{path!r} leads to a record, a list or true/false, not to a number")
    return value or ""


def loaded_json(text: str) -> Any:
    """Read JSON; numbers stay as they are written, and a record has no key twice."""
    return json.loads(
        text, parse_float=str, parse_int=str, parse_constant=str, object_pairs_hook=_unique_keys
    )


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Make a JSON record, and refuse one that has a key twice."""
    record = dict(pairs)
    if len(record) < len(pairs):
        raise ValueError("the record has a key twice")
    return record


def fold(name: str) -> str:
    """Write a name in one Unicode form (NFC), without zero-width characters and surplus spaces."""
    visible = _ZERO_WIDTH.sub("", unicodedata.normalize("NFC", name))
    return " ".join(visible.split())
