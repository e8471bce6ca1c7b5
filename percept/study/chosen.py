"""Names an analyst chooses among those a study has."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from percept.errors import UsageError

__all__ = ["chosen"]


def chosen(what: str, asked: str | Collection[str] | None, there: Sequence[str]) -> tuple[str, ...]:
    """Return the names asked for, if all are there.

    Parameters
    ----------
    what : str
        What they name, in the singular, for the message.
    asked : str or collection of str, or None
        One name or several; None for all.
    there : sequence of str
        Names there are.

    Returns
    -------
    tuple of str

    Raises
    ------
    UsageError
        A name that is not there.
    """
    if asked is None:
        return tuple(there)
    names = (asked,) if isinstance(asked, str) else tuple(asked)
    for name in names:
        if name not in there:
            raise UsageError(f"the study has no such {what}; there are {', '.join(there)}.", value=name)
    return names
