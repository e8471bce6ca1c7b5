"""Files larger than memory: checked and reduced, block by block, to what the models need."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from percept.errors import UsageError
from percept.sessions.cell_sums import CellSums, Reduced
from percept.sessions.options import ReadOptions
from percept.sessions.problems import Problems
from percept.sessions.read import not_read, read_parts
from percept.sessions.records import Source
from percept.sessions.sources import expand, names_from_file
from percept.sessions.stream import NotPlain, open_stream


def reduce_sessions(
    *paths: str | Path,
    family: Literal["lognormal", "normal"] = "lognormal",
    columns: Mapping[str, Any] | None = None,
    options: ReadOptions | None = None,
) -> Reduced:
    """Read files of any size in bounded memory, with the checks of :func:`read_sessions`.

    Parameters
    ----------
    *paths : str or Path
        As for :func:`read_sessions`. Large plain files are read in blocks, others as a whole, one by one.
    family : {"lognormal", "normal"}, optional
        Scale of the responses.
    columns, options
        As for :func:`read_sessions`.

    Returns
    -------
    Reduced

    Raises
    ------
    UsageError
        As :func:`read_sessions`.
    RefusalError
        An adjustment of zero or below on the log scale, or such a reference on either.
    """
    options = (options or ReadOptions()).with_columns(columns)
    if family not in ("lognormal", "normal"):
        raise UsageError('family is "lognormal" or "normal".', value=family)
    found = expand(paths)
    state = CellSums(family, options)
    for file in found.files:
        state = _with_stream(state, file) or _with_whole(state, file)
    state.notices = not_read(found) + state.notices
    return state.reduced()


def _with_stream(before: CellSums, file: str) -> CellSums | None:
    """Reduce a large plain file; None where it has to be read as a whole."""
    problems = Problems()
    named = names_from_file(file, before.options.filename, file=file)
    stream = open_stream(file, options=before.options, named=named, problems=problems)
    if stream is None:
        return None
    state = copy.deepcopy(before)
    state.measure(stream.part.parameters, file)
    try:
        for frame in stream.frames():
            if len(frame) and not len(problems):
                state.add(frame, file)
    except NotPlain:
        return None
    problems.raise_if_any()
    state.finish(
        [Source(file, stream.sha256, stream.part.counts["rows read"])], stream.part.notices, [stream.part]
    )
    return state


def _with_whole(state: CellSums, file: str) -> CellSums:
    parts, sources, notices = read_parts(file, state.options)
    for part in parts:
        if part.form != "trials":
            raise UsageError(
                "a published summary is not reduced.", file=file, hint="Read it with read_sessions."
            )
        state.measure(part.parameters, file)
        if len(part.frame):
            state.add(part.frame, sources[int(part.frame["file"].iloc[0])].name)
    state.finish(sources, notices, parts)
    return state
