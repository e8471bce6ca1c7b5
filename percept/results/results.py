"""Results: everything a report needs of a study, and report.json, which is the same as text."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import field
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from percept.errors import UsageError
from percept.results.boundaries import Band, Boundary
from percept.results.checks import Checks, Diagnostics
from percept.results.coupling import (
    AdmissibleCouplings,
    Coupling,
    OtherDevices,
    Rendered,
    Verdict,
    ZWidth,
)
from percept.results.data import Data, Provenance
from percept.results.findings import Findings
from percept.results.intervals import (
    AnovaRow,
    BandPair,
    ContrastRow,
    IntervalRow,
    Ladder,
    LevelValues,
    MethodPair,
)
from percept.results.plain import JsonObject, dumps, plain
from percept.results.psychophysics import EquivalenceRow, PseLineRow, PsychophysicsRow
from percept.results.shared import share_curves, with_shared_curves

#: Where boundaries stand in report.json, and where the curves do that those share.
_CURVES = {"boundaries": "impedances", "close": "close_impedances"}

#: Of report.json and fit.json: the name, and the version of its fields.
SCHEMA = "percept-report/5"


#: Does some work while the caller goes on: gives a function that waits for its result.
Beside = Callable[[Callable[[], Any]], AbstractContextManager[Callable[[], Any]]]


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

    step: str  # What a command shows while it is worked out; empty of what takes no time
    of: str  # The attribute; empty where it has the field's name
    needs: Literal["", "curves", "why"]  # What must be asked for
    beside: bool  # Whether a second process works it out, where there is one


def _part(
    step: str = "",
    *,
    of: str = "",
    needs: Literal["", "curves", "why"] = "",
    beside: bool = False,
) -> dict[str, Part]:
    """Describe where a field comes from."""
    return {"part": Part(step, of, needs, beside)}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """What a study gives, computed once; None or empty where it was not asked for.

    Numbers are in the units of the quantities, and in N/m, N·s/m, rad/s, kg and s. There are no run
    times and no folders in it: the same input and seed give the same results.
    """

    provenance: Provenance = field(metadata=_part())
    data: Data = field(metadata=_part(of="read"))
    intervals: tuple[IntervalRow, ...] = field(
        metadata=_part("working out intervals", of="interval_rows")
    )
    contrast: tuple[ContrastRow, ...] = field(
        metadata=_part("contrasting levels", of="contrast_rows")
    )
    boundaries: tuple[Boundary, ...] = field(
        metadata=_part("working out boundaries", needs="curves"), default=()
    )
    #: Window of omega of each environment's close view, rad/s
    zoom: dict[str, tuple[float, float]] = field(
        metadata=_part(needs="curves"), default_factory=dict
    )
    close: tuple[Boundary, ...] = field(
        metadata=_part(needs="curves"), default=()
    )  # Drawn in those windows
    #: Empty without a device
    verdicts: tuple[Verdict, ...] = field(
        metadata=_part("judging what feels real", of="verdict_rows", needs="curves", beside=True),
        default=(),
    )
    #: In time; None without curves
    rendering: tuple[Rendered, ...] | None = field(metadata=_part(needs="curves"), default=None)
    zwidth: ZWidth | None = field(
        metadata=_part(needs="curves"), default=None
    )  # None without a device
    coupling: Coupling | None = field(
        metadata=_part("judging what can be rendered", of="coupling_row", needs="curves"),
        default=None,
    )
    band: Band | None = field(metadata=_part("fitting the band law", needs="curves"), default=None)
    design: AdmissibleCouplings | None = field(
        metadata=_part("mapping couplings", needs="curves", beside=True), default=None
    )
    sensitivity: OtherDevices | None = field(
        metadata=_part("trying other devices", of="other_devices", needs="curves", beside=True),
        default=None,
    )
    comparison: tuple[MethodPair, ...] | None = field(metadata=_part("comparing the methods"))
    #: The methods' boundaries against each other
    band_pairs: tuple[BandPair, ...] | None = field(metadata=_part(needs="curves"), default=None)
    ladder: Ladder | None = field(metadata=_part(needs="why"), default=None)
    diagnostics: Diagnostics | None = field(metadata=_part())
    checks: Checks | None = field(metadata=_part("checking the model", of="all_checks"))
    #: Without curves, these are skipped as a whole
    skipped: tuple[Skipped, ...] = field(metadata=_part(of="skipped_rows", needs="curves"))
    #: Tests of the terms of `contrast`; empty without factors
    anova: tuple[AnovaRow, ...] = field(metadata=_part(), default=())
    levels: tuple[LevelValues, ...] = field(
        metadata=_part(), default=()
    )  # Subjects' means at levels of factors
    psychophysics: tuple[PsychophysicsRow, ...] = field(
        metadata=_part(of="psychophysics_rows"), default=()
    )
    #: Empty without three references, and without the model
    pse_lines: tuple[PseLineRow, ...] = field(metadata=_part(), default=())
    #: Empty without `[study] jnd`
    equivalence: tuple[EquivalenceRow, ...] = field(
        metadata=_part(of="equivalence_rows"), default=()
    )

    def to_json(self, summary: Findings | None = None) -> str:
        """Write the results as report.json holds them.

        Parameters
        ----------
        summary : Findings, optional
            What the first screen says, worked out from the results; `load` passes it over.

        Returns
        -------
        str
            Every digit of every number; "inf" and "-inf" for infinities, null for NaN. Curves that
            all boundaries of an environment share stand once, under "impedances".
        """
        document: JsonObject = {"schema": SCHEMA}
        for one in dataclasses.fields(self):
            document[one.name] = plain(getattr(self, one.name))
        for boundaries, shared in _CURVES.items():
            document[shared] = share_curves(document[boundaries])
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
            return cls.from_plain(document)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = "/".join(str(step) for step in first["loc"])
            raise UsageError(f"{first['msg']}.", file=str(path), key=place) from None

    @classmethod
    def from_plain(cls, document: JsonObject) -> Results:
        """Make results of report.json's values; pydantic's ValidationError names what is wrong."""
        complete = dict(document)
        for boundaries, shared in _CURVES.items():
            curves = complete.pop(shared, {})
            complete[boundaries] = with_shared_curves(complete.get(boundaries), curves)
        return _schema().validate_python(complete)


@cache
def _schema() -> TypeAdapter[Results]:
    """Return the schema of the records' own types; it takes a moment to build."""
    return TypeAdapter(Results)
