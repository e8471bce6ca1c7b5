"""Tables of simulated sessions: they say in every row that they are simulated, and in every file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from percept.durable import write_whole
from percept.errors import RefusalError, UsageError
from percept.simulate.design import Design

SOURCE = "simulated"


def session_table(
    design: Design,
    subject: ArrayLike,
    environment: ArrayLike,
    trial: ArrayLike,
    adjusted: NDArray[np.float64],
) -> pd.DataFrame:
    """Tidy table of N simulated trials.

    Parameters
    ----------
    design : Design
        Names and references.
    subject, environment : (N,) array_like of int
        Index into the design's subjects and environments.
    trial : (N,) array_like of int
        Number of the trial within its cell, from 1.
    adjusted : (N, P) array
        Adjusted values in the order of the design's parameters, N/m and N·s/m.

    Returns
    -------
    pandas.DataFrame
        subject, session, environment, k_ref, b_ref, trial, k_adj, b_adj, source; the columns of a
        parameter that is not adjusted are left out.
    """
    j = np.asarray(environment)
    columns: dict[str, object] = {
        "subject": np.array(design.subjects, dtype=object)[np.asarray(subject)],
        "session": "1",
        "environment": np.array(design.environments, dtype=object)[j],
    }
    columns |= {f"{name}_ref": design.references[j, p] for p, name in enumerate(design.parameters)}
    columns["trial"] = np.asarray(trial)
    columns |= {f"{name}_adj": adjusted[:, p] for p, name in enumerate(design.parameters)}
    columns["source"] = SOURCE
    return pd.DataFrame(columns)


def write_sessions(table: pd.DataFrame, path: str | os.PathLike[str]) -> Path:
    """Write simulated sessions as a CSV; equal tables give equal bytes.

    Numbers are written with the fewest digits that read back as the same double. The file appears
    whole or not at all.

    Parameters
    ----------
    table : pandas.DataFrame
        As `simulate` or `simulate_like` makes it.
    path : str or path-like
        The file to write; its folder must exist.

    Returns
    -------
    pathlib.Path
        The file written.

    Raises
    ------
    UsageError
        If a row does not say that it is simulated, the file is there and was not simulated, or it cannot be
        written.
    RefusalError
        If a value is not a finite number.
    """
    target = Path(path)
    if "source" not in table or not (table["source"] == SOURCE).all():
        raise UsageError(
            f"every row of a simulated table must say {SOURCE!r} in its column 'source'.",
            column="source",
            hint="Write measured sessions with pandas instead.",
        )
    if not target.parent.is_dir():
        raise UsageError("the folder to write to does not exist.", file=str(target), hint="Make it first.")
    if target.is_file() and not _simulated(target):
        raise UsageError(
            "is there already, and was not simulated.", file=str(target), hint="Choose another name."
        )
    text = table.copy()
    for name in text.columns[[dtype.kind == "f" for dtype in text.dtypes]]:
        values = table[name].to_numpy()
        if not np.isfinite(values).all():
            raise RefusalError("a simulated value is not finite.", file=str(target), column=name)
        text[name] = [np.format_float_positional(value, trim="-") for value in values]
    try:
        write_whole(target, text.to_csv(index=False, lineterminator="\n").encode())
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(target)) from error
    return target


def _simulated(file: Path) -> bool:
    """Whether a file says in its first row that it was simulated."""
    try:
        first = pd.read_csv(file, usecols=["source"], nrows=1)
    except (OSError, ValueError):
        return False
    return bool((first["source"] == SOURCE).all()) and len(first) > 0
