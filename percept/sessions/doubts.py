"""What an analyst should look at before believing a study: slips, knobs that never moved, cells not tried."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from percept.errors import counted
from percept.sessions.problems import shown
from percept.sessions.records import Notice

if TYPE_CHECKING:
    from percept.sessions.records import Sessions

#: From so many times the median of its environment's adjustments, or as small a part of it, a value is looked
#: at: a unit's or a digit's slip, and hardly ever a person.
_FAR = 30.0
#: Subjects an environment needs for its median to say anything of one of them.
_FEWEST = 3
#: Values of a parameter that are named one by one.
_MOST = 5


def doubts(sessions: Sessions) -> tuple[Notice, ...]:
    """Find what is seldom meant. Nothing is left out: that is for the analyst to declare."""
    if sessions.form != "trials":
        return ()
    found: list[Notice] = []
    for parameter in sessions.parameters:
        found += _slips(sessions, parameter)
        found += _without_logarithm(sessions, parameter)
        found += _never_moved(sessions, parameter)
    return (*found, *_not_tried(sessions))


def _slips(sessions: Sessions, parameter: str) -> Iterator[Notice]:
    table, column = sessions.table, f"{parameter}_adj"
    positive = table[table[column] > 0]
    by_environment = positive.groupby("environment", sort=False)
    typical = by_environment[column].transform("median").to_numpy()
    enough = by_environment["subject"].transform("nunique").to_numpy() >= _FEWEST
    values = positive[column].to_numpy(dtype=float)
    far = enough & ((values > _FAR * typical) | (values < typical / _FAR))
    found = np.flatnonzero(far).tolist()
    for at in found[:_MOST]:
        row = positive.iloc[at]
        file, line = _place(sessions, positive.index[at])
        yield Notice(
            f"subject {shown([row['subject']])} set {parameter} to {values[at]:.6g} in "
            f"{shown([row['environment']])}, {values[at] / typical[at]:.2g} times the median of "
            f"{typical[at]:.6g} there: a slip?",
            file, line, column,
        )  # fmt: skip
    if len(found) > _MOST:
        rest = counted(len(found) - _MOST, "more value")
        yield Notice(f"and {rest} of {parameter} as far from the median there", column=column)


def _without_logarithm(sessions: Sessions, parameter: str) -> Iterator[Notice]:
    column = f"{parameter}_adj"
    low = sessions.table.index[sessions.table[column] <= 0]
    if len(low):
        file, line = _place(sessions, low[0])
        what = f"{counted(len(low), 'value')} of {parameter} {'is' if len(low) == 1 else 'are'}"
        yield Notice(
            f"{what} zero or negative, here the first: the lognormal family, the default, takes none",
            file, line, column,
        )  # fmt: skip


def _never_moved(sessions: Sessions, parameter: str) -> Iterator[Notice]:
    column = f"{parameter}_adj"
    known = sessions.table[sessions.table[column].notna()]
    still = pd.DataFrame(
        {"subject": known["subject"], "same": known[column] == known[f"{parameter}_ref"]}
    ).groupby("subject", sort=False)["same"]
    told = still.agg(["all", "size"])
    names = [str(name) for name in told.index[told["all"] & (told["size"] > 1)]]
    if names:
        who = "subject" if len(names) == 1 else "subjects"
        yield Notice(
            f"{who} {shown(names)} left {parameter} at the reference in every trial: "
            "was what they set recorded?",
            column=column,
        )


def _not_tried(sessions: Sessions) -> Iterator[Notice]:
    tried = set(map(tuple, sessions.table[["subject", "environment"]].drop_duplicates().to_numpy().tolist()))
    # Looked up once: each of them goes over all rows.
    subjects, environments = sessions.subjects, sessions.environments
    lacking = [
        f"{subject} at {environment}"
        for subject in subjects
        for environment in environments
        if (subject, environment) not in tried
    ]
    if lacking:
        has = "has" if len(lacking) == 1 else "have"
        yield Notice(f"{counted(len(lacking), 'cell')} {has} no trial: {shown(lacking)}")


def _place(sessions: Sessions, index: int) -> tuple[str | None, int | None]:
    """File and row of an observation; sessions put together by hand have none."""
    return sessions.locate(index) if index in sessions.provenance.index else (None, None)
