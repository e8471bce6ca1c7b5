"""Names an analyst chooses among those a study has."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from percept.errors import RefusalError, UsageError
from percept.scene import Scene
from percept.study.units import NAMES


def analysed(present: tuple[str, ...], scene: Scene) -> tuple[str, ...]:
    """Return the parameters a scene names, or all that were adjusted."""
    asked = scene.inference.parameters
    if not present:
        raise RefusalError("no adjusted value is left in the data.")
    missing = sorted(set(asked or ()) - set(present))
    if missing:
        raise RefusalError(
            f"the scene asks for {NAMES[missing[0]]}, which no session has.", column=f"{missing[0]}_adj"
        )
    return tuple(asked) if asked else present


def chosen(what: str, asked: str | Collection[str] | None, there: Sequence[str]) -> tuple[str, ...]:
    """Return the names asked for, if all are there."""
    if asked is None:
        return tuple(there)
    names = (asked,) if isinstance(asked, str) else tuple(asked)
    for name in names:
        if name not in there:
            raise UsageError(f"the study has no such {what}; there are {', '.join(there)}.", value=name)
    return names
