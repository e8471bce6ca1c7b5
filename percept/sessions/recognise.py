"""Files of experiment software that are not tables: recognised by their first bytes, refused with a hint."""

from __future__ import annotations

import re

from percept.errors import UsageError

# Such files show what they are early; the bound keeps the search short.
_EARLY = 20_000

_BINARY = (
    (re.compile(rb"\x80[\x02-\x05]"), "a Python pickle (PsychoPy's .psydat), which is never opened",
     "Use the .csv that PsychoPy writes beside it."),
    (re.compile(rb"\xd0\xcf\x11\xe0"), "an old Office or E-Prime binary file",
     "Save it as .xlsx, or as CSV in UTF-8."),
    (re.compile(rb"%PDF"), "a PDF", "Use the table it was made from, as CSV."),
    (re.compile(rb"SQLite format 3"), "a database file", "Export the table from it as CSV."),
    (re.compile(rb"(Rar!|7z\xbc\xaf|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd)"), "an archive in a format not read here",
     "Unpack it, or pack it as .zip or .gz."),
)  # fmt: skip

_TEXT = (
    (re.compile(r"\s*\*\*\* Header Start \*\*\*"), "an E-Prime log in frames, not a table",
     "In E-DataAid or E-Merge export it as tab-delimited or CSV text and read that."),
    (re.compile(r"\s*reversal(Intensities|Indices)=", re.IGNORECASE),
     "PsychoPy's text summary of a staircase, not a table of trials",
     "Use the trial-by-trial .csv that PsychoPy writes beside it."),
    (re.compile(r"\s*(<!doctype|<html|<\?xml)", re.IGNORECASE), "a web page or XML, not a table",
     "Export the data as CSV."),
    (re.compile(r"\s*(\{\s*[\"}]|\[\s*[\[{])"), "JSON, not a table",
     "Export it as CSV (jsPsych: jsPsych.data.get().csv())."),
)  # fmt: skip


def refuse_binary(data: bytes, *, file: str) -> None:
    """Refuse a binary file that cannot hold a session table."""
    if not data:
        raise UsageError("the file is empty.", file=file, hint="Leave it out, or export it again.")
    for pattern, what, hint in _BINARY:
        if pattern.match(data):
            raise UsageError(f"this is {what}.", file=file, hint=hint)


def refuse_text(text: str, *, file: str) -> None:
    """Refuse a text file that is a known output of experiment software but no table."""
    for pattern, what, hint in _TEXT:
        if pattern.match(text, 0, _EARLY):
            raise UsageError(f"this is {what}.", file=file, hint=hint)
    if _is_psychopy_summary(text[:_EARLY]):
        raise UsageError(
            "this is PsychoPy's summary of conditions, not a table of trials.",
            file=file,
            hint="Use the trial-by-trial .csv (saveAsWideText) that PsychoPy writes beside it.",
        )


def _is_psychopy_summary(text: str) -> bool:
    """Whether the columns are means and raw values of conditions, or a block of extraInfo follows them."""
    lines = text.splitlines()
    header = re.split(r"[\t,;]", lines[0].strip()) if lines else []
    raw = any(name.endswith("_raw") for name in header)
    averaged = any(name.endswith(("_mean", "_std")) for name in header)
    return (raw and averaged) or any(line.strip("\t,; ") == "extraInfo" for line in lines)
