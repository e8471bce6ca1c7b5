"""What one file gave, and what its header must hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from percept.errors import UsageError
from percept.sessions.columns import Resolution
from percept.sessions.options import KEPT_COLUMNS, ReadOptions
from percept.sessions.problems import shown
from percept.sessions.records import Exclusion, Notice


@dataclass
class Part:
    """What one file gave."""

    form: str
    frame: pd.DataFrame  # The canonical columns, the groups, and `row`, the physical row of each
    counts: Counter[str] = field(default_factory=Counter)  # Rows by what became of them
    exclusions: list[Exclusion] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    parameters: set[str] = field(default_factory=set)
    declared_units: set[str] = field(default_factory=set)  # Columns whose unit was declared


def check_columns(
    part: Part,
    header: Sequence[str],
    resolution: Resolution,
    *,
    file: str,
    options: ReadOptions,
    named: Mapping[str, str],
) -> None:
    """Hold a header to what the analysis needs, and note in `part` what was found."""
    part.notices += [Notice(text, file) for text in resolution.announced]
    part.declared_units = {c for c, rule in resolution.rules.items() if rule.unit is not None}
    for c in sorted(named.keys() & resolution.present):
        text = f"{c} is taken from the file's name; column {resolution.rules[c].name!r} is not used"
        part.notices.append(Notice(text, file))
    unused = _unused(header, resolution, options)
    if unused:
        part.notices.append(Notice(f"columns not used: {shown(unused)}", file))
    if resolution.form == "trials":
        _require(resolution, header, file, options, named)
        part.parameters = {p for p in ("k", "b") if f"{p}_adj" in resolution.present}


def _require(
    resolution: Resolution, header: Sequence[str], file: str, options: ReadOptions, named: Mapping[str, str]
) -> None:
    """Raise where a column that the analysis cannot do without is nowhere."""
    present = resolution.present
    wide = any(slot.environment is not None for slot in resolution.slots)
    missing = [c for c in ("subject", "environment") if c not in present and c not in named]
    if wide and "environment" in missing:
        missing.remove("environment")
    adjusted = present & {"k_adj", "b_adj"}
    if not adjusted:
        missing.append("k_adj (or b_adj)")
    for p in ("k", "b") if adjusted else ():
        has = any(f"{p}_ref" in references for references in options.environments.values())
        if f"{p}_adj" in present and f"{p}_ref" not in present and not has:
            missing.append(f"{p}_ref")
        if f"{p}_ref" in present and f"{p}_adj" not in present:
            missing.append(f"{p}_adj")
    if missing:
        what = " and ".join(missing)
        raise UsageError(
            f"there is no column for {what}; the columns are {shown(header)}.",
            file=file,
            row=1,
            column=missing[0].split(" ")[0],
            hint="Name it in the scene's [columns]"
            + (
                ', or take it from file names with [sessions] filename = "{subject}".'
                if "subject" in missing
                else "."
            )
            + (" References can stand in [environments]." if any("_ref" in m for m in missing) else ""),
        )


def _unused(header: Sequence[str], resolution: Resolution, options: ReadOptions) -> list[str]:
    used = {at for slot in resolution.slots for at in slot.columns.values()}
    named = {*options.groups, *options.only, *(rule.column for rule in options.exclude), *KEPT_COLUMNS}
    return [name for at, name in enumerate(header) if at not in used and name and name not in named]
