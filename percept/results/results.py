"""Results: everything a report needs of a study, and report.json, which is the same as text."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import numpy as np
from pydantic import TypeAdapter, ValidationError

from percept.errors import UsageError
from percept.results.data import Checks, Data, Diagnostics, Provenance
from percept.results.display import (
    AdmissibleCouplings,
    Band,
    Boundary,
    Coupling,
    OtherDevices,
    Rendered,
    Verdict,
    ZWidth,
)
from percept.results.intervals import (
    AnovaRow,
    BandPair,
    ContrastRow,
    EquivalenceRow,
    IntervalRow,
    Ladder,
    LevelValues,
    MethodPair,
    PsychophysicsRow,
)

#: Of report.json and fit.json: the name, and the version of its fields.
SCHEMA = "percept-report/7"
#: Fields of `Results` that are tables: columns in report.json, CSV in a report's folder.
TABLES = (
    "intervals",
    "boundaries",
    "band_pairs",
    "psychophysics",
    "equivalence",
    "contrast",
    "anova",
    "verdicts",
    "rendering",
)

#: Does some work while the caller goes on, as `percept.workers.beside` does.
Beside = Callable[..., AbstractContextManager[Callable[..., Callable[[], Any]]]]
#: A record or a mapping as JSON holds it.
JsonObject = dict[str, Any]

#: Curves that depend on the environment, device and coupling, and on no interval.
_SHARED = ("omega", "reference", "coupled")
#: Characters that move a terminal's cursor or hide text: C1 controls, and marks of direction.
_HIDDEN = re.compile("[\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]")
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def in_turn(
    prepare: Callable[[], Callable[..., Any]],
) -> AbstractContextManager[Callable[..., Callable[[], Any]]]:
    """Do some work when its result is asked for, in this process."""
    return nullcontext(lambda *given: partial(prepare(), *given))


@dataclasses.dataclass(frozen=True)
class Skipped:
    """A result that a study did not compute.

    Parameters
    ----------
    what : str
        Name of the result, as `percept.Study.skipped` and the report list it.
    why : str
        The reason, in words.
    """

    what: str
    why: str


@dataclasses.dataclass(frozen=True)
class Part:
    """Where a field of `Results` comes from: an attribute of the study."""

    step: str = ""  # What a command shows while it is worked out; empty of what takes no time
    of: str = ""  # The attribute; empty where it has the field's name
    needs: Literal["", "curves", "why"] = ""  # What must be asked for
    beside: bool = False  # Whether a second process works it out, where there is one


@dataclasses.dataclass(frozen=True)
class Findings:
    """What the first screen of a page says: the summary of report.json."""

    sentences: tuple[str, ...]
    cautions: tuple[str, ...]
    paragraph: str  # Of results, to paste into a paper; empty without intervals


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """What a study gives, computed once; None or empty where it was not asked for.

    Numbers are in the units of the quantities, and in N/m, N·s/m, rad/s, kg and s. There are no run
    times and no folders in it: the same input and seed give the same results.
    """

    #: Versions, seed, digests of the input, and the scene with its defaults
    provenance: Provenance
    #: Counts, exclusions by reason, notices, the values of every cell, and what each subject did
    data: Annotated[Data, Part(of="read")]
    #: One for each environment, quantity, method, kind, family and joint treatment
    intervals: Annotated[tuple[IntervalRow, ...], Part("working out intervals", of="interval_rows")]
    #: Levels of factors compared two by two, interactions, and slopes of covariates
    contrast: Annotated[
        tuple[ContrastRow, ...], Part("contrasting levels", of="contrast_rows", beside=True)
    ]
    #: Curves of each environment's limits, with their Monte Carlo error
    boundaries: Annotated[tuple[Boundary, ...], Part("working out boundaries", needs="curves")] = ()
    #: Whether each environment feels real, by both methods; empty without a device
    verdicts: Annotated[
        tuple[Verdict, ...],
        Part("judging what feels real", of="verdict_rows", needs="curves", beside=True),
    ] = ()
    #: Whether the device renders each environment with every passive hand, in time
    rendering: Annotated[tuple[Rendered, ...] | None, Part(needs="curves")] = None
    #: The edge of what the device renders; None without a device
    zwidth: Annotated[ZWidth | None, Part(needs="curves")] = None
    #: The paper's Eq. 10 for the coupling, and the paper's rule
    coupling: Annotated[
        Coupling | None, Part("judging what can be rendered", of="coupling_row", needs="curves")
    ] = None
    #: Widths of users' intervals, and the laws fitted to them
    band: Annotated[Band | None, Part("fitting the band law", needs="curves")] = None
    #: Probability that couplings feel real; the softest and the stiffest that do
    design: Annotated[
        AdmissibleCouplings | None, Part("mapping couplings", needs="curves", beside=True)
    ] = None
    #: Probability of feeling real at half and 1.5 times the device's mass and damping
    sensitivity: Annotated[
        OtherDevices | None,
        Part("trying other devices", of="other_devices", needs="curves"),
    ] = None
    #: The two methods in pairs
    comparison: Annotated[tuple[MethodPair, ...] | None, Part("comparing the methods")]
    #: The methods' boundaries against each other
    band_pairs: Annotated[tuple[BandPair, ...] | None, Part(needs="curves")] = None
    #: Why the methods differ, step by step
    ladder: Annotated[Ladder | None, Part(needs="why")] = None
    #: The sampler's checks
    diagnostics: Diagnostics | None
    #: The model's checks
    checks: Annotated[Checks | None, Part("checking the model", beside=True)]
    #: What was not computed, and why
    skipped: Annotated[tuple[Skipped, ...], Part(of="skipped_before_curves", beside=True)]
    #: Tests of the terms of `contrast`; empty without factors
    anova: Annotated[tuple[AnovaRow, ...], Part(beside=True)] = ()
    #: What each subject set at every level of a factor
    levels: tuple[LevelValues, ...] = ()
    #: Points of equality, thresholds, spreads and reliability
    psychophysics: Annotated[
        tuple[PsychophysicsRow, ...], Part(of="psychophysics_rows", beside=True)
    ] = ()
    #: Whether each bias is smaller than one JND; empty without `[study] jnd`
    equivalence: Annotated[
        tuple[EquivalenceRow, ...], Part(of="equivalence_rows", beside=True)
    ] = ()

    def to_json(self, summary: Findings | None = None) -> str:
        """Write the results as report.json holds them.

        Parameters
        ----------
        summary : Findings, optional
            What the first screen says, worked out from the results; `load` passes it over.

        Returns
        -------
        str
            Every digit of every number; "inf" and "-inf" for infinities, null for NaN. A table has
            a list per field. What its rows share stands once: curves of an environment under
            "impedances", and sentences, which rows of intervals name by their place, under
            "covers".
        """
        document: JsonObject = {"schema": SCHEMA}
        for one in dataclasses.fields(self):
            document[one.name] = plain(getattr(self, one.name))
        document["impedances"] = share_curves(document["boundaries"])
        sentences = document["covers"] = list(dict.fromkeys(row.covers for row in self.intervals))
        for row in document["intervals"]:
            row["covers"] = sentences.index(row["covers"])
        for name in TABLES:
            if rows := document[name]:
                document[name] = {field: [row[field] for row in rows] for field in rows[0]}
        if summary is not None:
            document["summary"] = plain(summary)
        return dumps(document)

    @classmethod
    def load(cls, path: str | Path) -> Results:
        """Read results back from report.json or fit.json.

        Parameters
        ----------
        path : str or Path
            A file that `to_json` wrote.

        Returns
        -------
        Results
            Equal to those that were written, digit for digit.

        Raises
        ------
        UsageError
            A file that cannot be read, is no JSON, or has another schema; the error names the
            entry.
        """
        try:
            document = json.loads(Path(path).read_bytes())
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}.", file=str(path)) from None
        except (ValueError, RecursionError) as error:
            raise UsageError(f"is not JSON: {error}.", file=str(path)) from None
        schema = document.get("schema") if isinstance(document, dict) else None
        if schema != SCHEMA:
            raise UsageError(
                f"This percept reads {SCHEMA}.",
                file=str(path),
                key="schema",
                value=schema,
                hint="Make the report again from its data.",
            )
        try:
            read_rows(document)
            return TypeAdapter(Results).validate_python(document)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = "/".join(map(str, first["loc"]))
            raise UsageError(f"{first['msg']}.", file=str(path), key=place) from None
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise UsageError(
                "its tables are damaged.",
                file=str(path),
                hint="Make the report again from its data.",
            ) from error


def parts() -> dict[str, Part]:
    """Return where each field of `Results` comes from."""
    hints = get_type_hints(Results, include_extras=True)
    return {name: getattr(hint, "__metadata__", [Part()])[0] for name, hint in hints.items()}


def share_curves(boundaries: list[JsonObject]) -> dict[str, JsonObject]:
    """Take the shared curves out of plain boundaries, and return them by environment."""
    return {
        boundary["environment"]: {name: boundary.pop(name) for name in _SHARED}
        for boundary in boundaries
    }


def read_rows(document: JsonObject) -> None:
    """Turn the tables of a document into rows, each with what it shares with others."""
    for name in TABLES:
        if columns := document[name]:
            rows = zip(*columns.values(), strict=True)
            document[name] = [dict(zip(columns, row, strict=True)) for row in rows]
    for row in document["intervals"]:
        row["covers"] = document["covers"][row["covers"]]
    for boundary in document["boundaries"]:
        boundary.update(document["impedances"][boundary["environment"]])


def plain(value: Any) -> Any:
    """Turn a result into JSON values, with every digit; NaN is None, infinities are text."""
    if value is None or isinstance(value, (str, int)):
        return value
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        return None if math.isnan(value) else str(float(value))
    if isinstance(value, Mapping):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if hasattr(value, "model_dump"):
        return plain(value.model_dump())
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if hasattr(value, "to_dict"):
        return plain(value.to_dict("records"))
    raise TypeError(f"{type(value).__name__} has no plain form.")


def dumps(document: JsonObject) -> str:
    """Write a plain document as JSON: full precision, stable order, readable, one final newline.

    Parameters
    ----------
    document : mapping
        As `plain` returns it.

    Returns
    -------
    str
        Lists of numbers stand on one line. Characters that a terminal would obey are escaped.

    Raises
    ------
    ValueError
        Where a NaN or an infinity is left.
    """
    text = _indented(document, "") + "\n"
    # They stand in texts only.
    return _HIDDEN.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _indented(value: Any, indent: str) -> str:
    """Write dicts, and lists of lists or dicts, an entry a line; lists of numbers stay on one."""
    deeper = indent + " "
    if isinstance(value, dict) and value:
        entries = [
            f"{_ENCODER.encode(name)}: {_indented(part, deeper)}" for name, part in value.items()
        ]
    elif isinstance(value, list) and any(isinstance(part, (dict, list)) for part in value):
        entries = [_indented(part, deeper) for part in value]
    else:
        return _ENCODER.encode(value)
    first, last = "{}" if isinstance(value, dict) else "[]"
    return f"{first}\n" + ",\n".join(deeper + entry for entry in entries) + f"\n{indent}{last}"
