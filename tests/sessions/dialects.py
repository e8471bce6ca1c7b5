"""Session files as experiment software writes them: generators for the reader's tests."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import pandas as pd

from percept import Scene


@dataclass(frozen=True)
class Trial:
    """One adjustment; None where the subject gave none."""

    subject: str
    session: str
    environment: str
    trial: int
    k_ref: float
    b_ref: float
    k_adj: float | None
    b_adj: float | None


Files = Mapping[str, bytes]


@dataclass(frozen=True)
class Writer:
    """A tool's way of writing trials."""

    write: Callable[[Sequence[Trial]], Files]  # To names and bytes of files
    tables: Mapping[str, object] = field(default_factory=dict)
    decimals: int | None = None  # Digits after the decimal mark, where the tool rounds

    @property
    def options(self) -> Scene:
        """`tables` as a scene."""
        return Scene(**self.tables)


_NAMES = "subject session environment trial k_ref b_ref k_adj b_adj"
_REFERENCES = {"VE1": (15.0, 0.7), "VE2": (1000.0, 1.5), "Wände 3": (10000.0, 10.0)}


def example(decimals: int | None = None) -> list[Trial]:
    """Three subjects, one of them named NA, three environments, two trials, one missing
    adjustment."""
    out = []
    for s, subject in enumerate(("001", "1", "NA")):
        for e, (environment, (k, b)) in enumerate(_REFERENCES.items()):
            for trial in (1, 2):
                wobble = 1 + ((s * 7 + e * 3 + trial * 5) % 11 - 5) / 37
                k_adj, b_adj = k * wobble, b / wobble
                if decimals is not None:
                    k_adj, b_adj = round(k_adj, decimals), round(b_adj, decimals)
                b_adj = None if (s, e, trial) == (1, 1, 2) else b_adj
                out.append(Trial(subject, "01", environment, trial, k, b, k_adj, b_adj))
    return out


def frame(trials: Sequence[Trial]) -> pd.DataFrame:
    """Trials as the table a reader should give."""
    return pd.DataFrame([vars(trial) for trial in trials])


def delimited(
    records: Iterable[Sequence[str]],
    *,
    delimiter: str = ",",
    newline: str = "\n",
    encoding: str = "utf-8",
    quoting: Literal[0, 1] = csv.QUOTE_MINIMAL,
) -> bytes:
    """CSV with quotes doubled (RFC 4180)."""
    out = io.StringIO()
    csv.writer(out, delimiter=delimiter, lineterminator=newline, quoting=quoting).writerows(records)
    return out.getvalue().encode(encoding)


def _records(
    trials: Sequence[Trial],
    names: str = _NAMES,
    *,
    mark: str = ".",
    missing: str = "",
    decimals: int | None = None,
) -> list[list[str]]:
    """A header and a row per trial; "column=value" writes a constant, "column:name" another name.

    Underscores in the tool's own names are spaces where they begin with a capital.
    """
    columns = [name.replace("=", ":=").split(":") for name in names.split(" ")]
    header = [own.replace("_", " ") if own[0].isupper() else own for own, *_ in columns]
    rows = [header]
    for trial in trials:
        row = []
        for own, *source in columns:
            name = source[0] if source else own
            value = name[1:] if name.startswith("=") else getattr(trial, name)
            if isinstance(value, float):
                text = repr(value) if decimals is None else f"{value:.{decimals}f}"
                value = text.replace(".", mark)
            row.append(missing if value is None else str(value))
        rows.append(row)
    return rows


def _one(
    name: str, write: Callable[[Sequence[Trial]], bytes]
) -> Callable[[Sequence[Trial]], Files]:
    return lambda trials: {name: write(trials)}


_PSYCHOPY = (
    "environment k_ref b_ref trials.thisRepN=0 trials.thisTrialN=0 trials.thisN:trial"
    " instructions.started=None k_adj b_adj slider.history=HISTORY slider.started=12.5"
    " participant:subject session date=2026-03-01_10h12 expName=matching psychopyVersion=2024.2.4"
    " frameRate=60.0"
)


def _psychopy(trials: Sequence[Trial], delimiter: str = ",", mark: str = ".") -> bytes:
    # A cell is quoted only where it holds the delimiter; nothing in it is escaped; each line ends
    # with one.
    history = "[np.float64(1.5), 0.36, 'said \"now\" twice']"
    lines = []
    for row in _records(trials, _PSYCHOPY, mark=mark, missing="None"):
        cells = [history if cell == "HISTORY" else cell for cell in row]
        quoted = [f'"{cell}"' if delimiter in cell else cell for cell in cells]
        lines.append("".join(cell + delimiter for cell in quoted) + "\n")
    return "".join(lines).encode("utf-8-sig")


def _psychopy_appended(trials: Sequence[Trial]) -> bytes:
    half = len(trials) // 2
    return b"".join(_psychopy(part) for part in (trials[:half], trials[half:]) if part)


def _jspsych(trials: Sequence[Trial]) -> bytes:
    names = "trial_type=slider trial_index=1 rt=812 stimulus=null slider_start=50 response=null"
    header, *rows = _records(trials, f"{names} {_NAMES.removesuffix(' k_adj b_adj')}")
    lines = [header]
    for trial, row in zip(trials, rows, strict=True):
        ready = ["keyboard", "0", "812", '<p class="big">Ready?</p>', "", '" "', *row[6:8]]
        response = json.dumps({"k": trial.k_adj, "b": trial.b_adj})
        lines += [ready + [""] * (len(row) - len(ready)), [*row[:5], response, *row[6:]]]
    return delimited(lines, newline="\r\n", quoting=csv.QUOTE_ALL)


def _opensesame(trials: Sequence[Trial]) -> Files:
    names = "k_adj b_adj b_ref environment k_ref note=NOTE session subject_nr:subject trial"
    files = {}
    for number, subject in enumerate(dict.fromkeys(trial.subject for trial in trials)):
        own = [trial for trial in trials if trial.subject == subject]
        rows = _records(own, names, missing="NA")
        cells = [[cell.replace("NOTE", 'he said "stop"') for cell in row] for row in rows]
        quoted = [",".join('"' + cell.replace('"', '\\"') + '"' for cell in row) for row in cells]
        files[f"subject-{number}.csv"] = "\n".join([*quoted, ""]).encode()
    return files


def _uxf(trials: Sequence[Trial], delimiter: str = ",", mark: str = ".") -> bytes:
    names = (
        "experiment=hbfd ppid:subject session_num:session trial_num:trial block_num=1 environment"
        " k_ref b_ref k_adj b_adj"
    )
    rows = _records(trials, names, mark=mark, missing="null", decimals=6)
    return delimited(rows, delimiter=delimiter)


def _gorilla(trials: Sequence[Trial]) -> bytes:
    names = (
        "Event_Index=1 UTC_Date=2026-03-01 Participant_Private_ID:subject Session:session"
        " Environment:environment Trial_Number:trial k_ref b_ref Response_Type=action k_adj b_adj"
    )
    header, *rows = _records(trials, names)
    lines = [header]
    for row in rows:
        first = ["1.5" if cell else "" for cell in row[-2:]]
        lines += [[*row[:-3], "continue", "", ""], [*row[:-2], *first], row]
    lines.append(["END OF FILE", *[""] * (len(header) - 1)])
    return delimited(lines, newline="\r\n")


def _excel_csv(trials: Sequence[Trial]) -> bytes:
    rows = _records(trials, mark=",")
    return b"sep=;\r\n" + delimited(rows, delimiter=";", newline="\r\n", encoding="cp1252")


def _utf_16(rows: Iterable[Sequence[str]]) -> bytes:
    return delimited(rows, delimiter="\t", newline="\r\n", encoding="utf-16")


def _eprime(trials: Sequence[Trial]) -> bytes:
    names = "Subject:subject Session:session Environment:environment Trial:trial k_ref b_ref"
    return _utf_16(_records(trials, f"{names} k_adj b_adj", missing="NULL"))


def _folder(trials: Sequence[Trial]) -> Files:
    files: dict[tuple[str, str], list[list[str]]] = {}
    header, *rows = _records(trials)
    for subject, session, *cells in rows:
        files.setdefault((subject, session), [header[2:]]).append(cells)
    return {f"sub-{s}_ses-{v}.csv": delimited(lines) for (s, v), lines in files.items()}


def _wide(trials: Sequence[Trial]) -> bytes:
    cells = list(dict.fromkeys((t.environment, t.trial) for t in trials))
    header, *rows = _records(trials)
    values = header[4:]
    names = [f"{value}_{name}_{number}" for name, number in cells for value in values]
    lines = [["subject", "session", *names]]
    of_cell = {(*row[:3], int(row[3])): row[4:] for row in rows}
    for own in dict.fromkeys((t.subject, t.session) for t in trials):
        numbers = [of_cell.get((*own, *cell), [""] * len(values)) for cell in cells]
        lines.append([*own, *(number for four in numbers for number in four)])
    return delimited(lines)


_WIDE = {c: f"{c}_{{environment}}_{{trial}}" for c in ("k_ref", "b_ref", "k_adj", "b_adj")}

WRITERS: Mapping[str, Writer] = {
    "plain": Writer(_one("plain.csv", lambda t: delimited(_records(t)))),
    "psychopy": Writer(_one("p.csv", _psychopy)),
    "psychopy tab": Writer(_one("p.tsv", lambda t: _psychopy(t, "\t"))),
    "psychopy semicolon": Writer(_one("p.csv", lambda t: _psychopy(t, ";"))),
    "psychopy appended": Writer(_one("p.csv", _psychopy_appended)),
    "psychopy european": Writer(_one("p.csv", lambda t: _psychopy(t, ";", ","))),
    "jspsych": Writer(
        _one("j.csv", _jspsych),
        {
            "columns": {c: {"name": "response", "path": c[0]} for c in ("k_adj", "b_adj")},
            "sessions": {"only": {"trial_type": "slider"}},
        },
    ),
    "opensesame": Writer(_opensesame),
    "uxf": Writer(_one("trial_results.csv", _uxf), decimals=6),
    "uxf european": Writer(_one("trial_results.csv", lambda t: _uxf(t, ";", ",")), decimals=6),
    "gorilla": Writer(
        _one("data_exp.csv", _gorilla),
        {"sessions": {"keep": "last", "only": {"Response Type": "action"}}},
    ),
    "e-prime export": Writer(_one("export.txt", _eprime)),
    "excel csv": Writer(_one("excel.csv", _excel_csv)),
    "excel unicode text": Writer(_one("excel.txt", lambda t: _utf_16(_records(t, mark=",")))),
    "folder": Writer(_folder, {"sessions": {"filename": "sub-{subject}_ses-{session}"}}),
    "wide": Writer(_one("wide.csv", _wide), {"columns": _WIDE}),
}
