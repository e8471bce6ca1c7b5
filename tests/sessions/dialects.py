"""Session files as experiment software writes them: generators for the reader's tests."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import pandas as pd

from percept.sessions.options import ReadOptions


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


@dataclass(frozen=True)
class Writer:
    """A tool's way of writing trials."""

    write: Callable[
        [Sequence[Trial]], Mapping[str, bytes]
    ]  # From trials to the files' names and bytes
    tables: Mapping[str, object] = field(default_factory=dict)
    decimals: int | None = None  # Digits after the decimal mark, where the tool rounds

    @property
    def options(self) -> ReadOptions:
        """`tables` as read options."""
        return ReadOptions.from_mapping(self.tables)


_NAMES = ("subject", "session", "environment", "trial", "k_ref", "b_ref", "k_adj", "b_adj")
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
                missing = (s, e, trial) == (1, 1, 2)
                out.append(
                    Trial(
                        subject, "01", environment, trial, k, b, k_adj, None if missing else b_adj
                    )
                )
    return out


def frame(trials: Sequence[Trial]) -> pd.DataFrame:
    """Trials as the table a reader should give."""
    return pd.DataFrame([{name: getattr(trial, name) for name in _NAMES} for trial in trials])


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


def _number(
    value: float | None, *, mark: str = ".", missing: str = "", decimals: int | None = None
) -> str:
    if value is None:
        return missing
    text = repr(float(value)) if decimals is None else f"{value:.{decimals}f}"
    return text.replace(".", mark)


def _records(
    trials: Sequence[Trial], *, names: Sequence[str] = _NAMES, **style: object
) -> list[list[str]]:
    return [list(names)] + [
        [t.subject, t.session, t.environment, str(t.trial)]
        + [_number(v, **style) for v in (t.k_ref, t.b_ref, t.k_adj, t.b_adj)]  # type: ignore[arg-type]
        for t in trials
    ]


def _one(
    name: str, write: Callable[[Sequence[Trial]], bytes]
) -> Callable[[Sequence[Trial]], Mapping[str, bytes]]:
    return lambda trials: {name: write(trials)}


def _psychopy_text(trials: Sequence[Trial], delimiter: str, mark: str = ".") -> str:
    header = [
        "environment", "k_ref", "b_ref", "trials.thisRepN", "trials.thisTrialN", "trials.thisN",
        "instructions.started", "k_adj", "b_adj", "slider.history", "slider.started", "participant",
        "session", "date", "expName", "psychopyVersion", "frameRate",
    ]  # fmt: skip
    lines = [header]
    for t in trials:
        numbers = [
            _number(v, mark=mark, missing="None") for v in (t.k_ref, t.b_ref, t.k_adj, t.b_adj)
        ]
        lines.append(
            [t.environment, *numbers[:2], "0", "0", str(t.trial), "None", *numbers[2:],
             f"[np.float64({t.k_ref!r}), 0.36, 'said \"now\" twice']", "12.5", t.subject, t.session,
             "2026-03-01_10h12", "matching", "2024.2.4", "60.0"]
        )  # fmt: skip
    # A cell is quoted only where it holds the delimiter; nothing in it is escaped; each line ends
    # with one.
    return "".join(
        "".join((f'"{cell}"' if delimiter in cell else cell) + delimiter for cell in line) + "\n"
        for line in lines
    )


def _psychopy(trials: Sequence[Trial], delimiter: str = ",", mark: str = ".") -> bytes:
    return _psychopy_text(trials, delimiter, mark).encode("utf-8-sig")


def _psychopy_appended(trials: Sequence[Trial]) -> bytes:
    half = len(trials) // 2
    return b"".join(_psychopy(part) for part in (trials[:half], trials[half:]) if part)


def _jspsych(trials: Sequence[Trial]) -> bytes:
    names = [
        "trial_type",
        "trial_index",
        "subject",
        "session",
        "environment",
        "trial",
        "k_ref",
        "b_ref",
        "rt",
        "stimulus",
        "response",
        "slider_start",
    ]
    rows = [names]
    for at, t in enumerate(trials):
        rows.append(["html-keyboard-response", str(2 * at), t.subject, t.session, *[""] * 4,
                     "812", '<p class="big">Ready?</p>', '" "', ""])  # fmt: skip
        response = json.dumps({"k": t.k_adj, "b": t.b_adj})
        rows.append(
            [
                "impedance-slider",
                str(2 * at + 1),
                t.subject,
                t.session,
                t.environment,
                str(t.trial),
                repr(t.k_ref),
                repr(t.b_ref),
                "null",
                "null",
                response,
                "50",
            ]
        )
    return delimited(rows, newline="\r\n", quoting=csv.QUOTE_ALL)


def _opensesame(trials: Sequence[Trial]) -> Mapping[str, bytes]:
    names = [
        "count_trial_sequence",
        "k_adj",
        "b_adj",
        "b_ref",
        "datetime",
        "environment",
        "k_ref",
        "note",
        "session",
        "subject_nr",
        "trial",
    ]
    files: dict[str, list[list[str]]] = {}
    for at, t in enumerate(trials):
        rows = files.setdefault(t.subject, [names])
        numbers = [_number(v, missing="NA") for v in (t.k_adj, t.b_adj, t.b_ref, t.k_ref)]
        rows.append([str(at), *numbers[:3], "03/01/26", t.environment, numbers[3], 'he said "stop"',
                     t.session, t.subject, str(t.trial)])  # fmt: skip
    return {
        f"subject-{at}.csv": (
            "".join(
                ",".join('"' + cell.replace('"', '\\"') + '"' for cell in row) + "\n"
                for row in rows
            ).encode()
        )
        for at, rows in enumerate(files.values())
    }


def _uxf(trials: Sequence[Trial], delimiter: str = ",", mark: str = ".") -> bytes:
    names = [
        "experiment",
        "ppid",
        "session_num",
        "trial_num",
        "block_num",
        "start_time",
        "environment",
        "k_ref",
        "b_ref",
        "k_adj",
        "b_adj",
    ]
    rows = [names]
    for t in trials:
        numbers = [
            _number(v, mark=mark, missing="null", decimals=6)
            for v in (t.k_ref, t.b_ref, t.k_adj, t.b_adj)
        ]
        start = _number(1.5, mark=mark, decimals=6)
        rows.append(
            ["hbfd", t.subject, t.session, str(t.trial), "1", start, t.environment, *numbers]
        )
    return delimited(rows, delimiter=delimiter)


def _gorilla(trials: Sequence[Trial]) -> bytes:
    names = [
        "Event Index",
        "UTC Date",
        "Participant Private ID",
        "Session",
        "Environment",
        "Trial Number",
        "k_ref",
        "b_ref",
        "Response Type",
        "k_adj",
        "b_adj",
    ]
    rows = [names]
    for t in trials:
        place = [
            "2026-03-01",
            t.subject,
            t.session,
            t.environment,
            str(t.trial),
            repr(t.k_ref),
            repr(t.b_ref),
        ]
        rows.append([str(len(rows)), *place, "continue", "", ""])
        first = ["1.5" if value is not None else "" for value in (t.k_adj, t.b_adj)]
        rows.append([str(len(rows)), *place, "action", *first])
        rows.append([str(len(rows)), *place, "action", _number(t.k_adj), _number(t.b_adj)])
    rows.append(["END OF FILE", *[""] * (len(names) - 1)])
    return delimited(rows, newline="\r\n")


def _excel_csv(trials: Sequence[Trial]) -> bytes:
    body = delimited(_records(trials, mark=","), delimiter=";", newline="\r\n", encoding="cp1252")
    return b"sep=;\r\n" + body


def _unicode_text(trials: Sequence[Trial]) -> bytes:
    return delimited(_records(trials, mark=","), delimiter="\t", newline="\r\n", encoding="utf-16")


def _eprime(trials: Sequence[Trial]) -> bytes:
    names = ["Subject", "Session", "Environment", "Trial", "k_ref", "b_ref", "k_adj", "b_adj"]
    records = _records(trials, names=names, missing="NULL")
    return delimited(records, delimiter="\t", newline="\r\n", encoding="utf-16")


def _folder(trials: Sequence[Trial]) -> Mapping[str, bytes]:
    files: dict[tuple[str, str], list[list[str]]] = {}
    for record in _records(trials)[1:]:
        files.setdefault((record[0], record[1]), [list(_NAMES[2:])]).append(record[2:])
    return {f"sub-{s}_ses-{v}.csv": delimited(rows) for (s, v), rows in files.items()}


def _wide(trials: Sequence[Trial]) -> bytes:
    cells = list(dict.fromkeys((t.environment, t.trial) for t in trials))
    values = ("k_ref", "b_ref", "k_adj", "b_adj")
    rows = [["subject", "session", *(f"{v}_{e}_{n}" for e, n in cells for v in values)]]
    for subject, session in dict.fromkeys((t.subject, t.session) for t in trials):
        own = {
            (t.environment, t.trial): t
            for t in trials
            if (t.subject, t.session) == (subject, session)
        }
        numbers = [_number(getattr(own[c], v)) if c in own else "" for c in cells for v in values]
        rows.append([subject, session, *numbers])
    return delimited(rows)


_WIDE = {c: f"{c}_{{environment}}_{{trial}}" for c in ("k_ref", "b_ref", "k_adj", "b_adj")}
_THIS_N = {"trial": "trials.thisN"}

WRITERS: Mapping[str, Writer] = {
    "plain": Writer(_one("plain.csv", lambda t: delimited(_records(t)))),
    "psychopy": Writer(_one("p.csv", _psychopy)),
    "psychopy tab": Writer(_one("p.tsv", lambda t: _psychopy(t, "\t"))),
    "psychopy semicolon": Writer(_one("p.csv", lambda t: _psychopy(t, ";"))),
    "psychopy appended": Writer(_one("p.csv", _psychopy_appended), {"columns": _THIS_N}),
    "psychopy european": Writer(_one("p.csv", lambda t: _psychopy(t, ";", ","))),
    "jspsych": Writer(
        _one("j.csv", _jspsych),
        {
            "columns": {c: {"name": "response", "path": c[0]} for c in ("k_adj", "b_adj")},
            "sessions": {"only": {"trial_type": "impedance-slider"}},
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
    "excel unicode text": Writer(_one("excel.txt", _unicode_text)),
    "folder": Writer(_folder, {"sessions": {"filename": "sub-{subject}_ses-{session}"}}),
    "wide": Writer(_one("wide.csv", _wide), {"columns": _WIDE}),
}
