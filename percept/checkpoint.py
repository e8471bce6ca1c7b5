"""Studies of a plan by their numbers or keys: each is worked on once, its result kept as a line."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from percept.cache import digest
from percept.errors import RefusalError, UsageError, counted
from percept.files import exclusive
from percept.workers import Mapper, in_process

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

#: The result of one study, as a line of JSON has it.
Line = dict[str, Any]
# How every line starts: what is left of one cut short is told from a file of something else.
_START = '{"plan": "'


def plan_digest(plan: DataclassInstance) -> str:
    """Return a digest that tells results of different plans apart."""
    return digest(dataclasses.asdict(plan))[:16]


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """A file of JSON lines, one per study of a plan; lines of other plans stand beside them."""

    path: Path | None  # Made where it does not exist; without one nothing is kept
    plan: str  # What tells the lines of this plan
    what: str  # What was done to the studies, for messages: "judged"

    def read(self) -> dict[Any, Line]:
        """Read the results of the plan's studies; cut off a last line that is not whole.

        Returns
        -------
        dict of int or str to Line
            The last result of each study, by its number or key.

        Raises
        ------
        UsageError
            The file holds something else.
        """
        if self.path is None or not self.path.exists():
            return {}
        try:
            with exclusive(self.path):
                lines = _lines(self.path)
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(
                f"no file of {self.what} studies.",
                file=str(self.path),
                hint="Choose another folder.",
            ) from error
        results = {}
        for row, line in enumerate(lines, start=1):
            try:
                result = json.loads(line)
                plan = result.pop("plan")
                index = result.pop("index")
                if not result:
                    raise ValueError("a line without a result")
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                message = f"not a line of {self.what} studies."
                raise UsageError(message, file=str(self.path), row=row) from error
            if plan == self.plan:
                results[index] = result
        return results

    def append(self, index: int | str, result: Line) -> None:
        """Write the result of a study behind the others."""
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        line = {"plan": self.plan, "index": index, **result}
        with self.path.open("a", encoding="utf-8") as file, exclusive(self.path):
            file.write(json.dumps(line) + "\n")
            # Before another run may write.
            file.flush()

    def complete(
        self,
        study: Callable[[int], Line],
        studies: int,
        *,
        mapper: Mapper = in_process,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[Line]:
        """Return the results of all studies, and work on those that are not kept yet.

        Parameters
        ----------
        study : callable
            Works on one study, by its number.
        studies : int
            How many.
        mapper : Mapper
            The workers.
        progress : callable, optional
            Told how many studies are finished, and of how many.

        Returns
        -------
        list of Line
            In the order of their numbers.

        Raises
        ------
        RefusalError
            Some studies ended in an error; all others are kept.
        """
        results = {index: line for index, line in self.read().items() if index in range(studies)}
        missing = [index for index in range(studies) if index not in results]
        errors: dict[int, Exception] = {}
        for index, result in mapper(study, missing):
            if isinstance(result, Exception):
                errors[index] = result
                continue
            results[index] = result
            self.append(index, result)
            if progress:
                progress(len(results), studies)
        if errors:
            first = min(errors)
            error = errors[first]
            raise RefusalError(
                f"{counted(len(errors), 'study', 'studies')} ended in an error; study {first}:"
                f" {type(error).__name__}: {error}",
                hint="The others are kept if there is a checkpoint: the same run again tries these"
                " only.",
            ) from error
        return [results[index] for index in sorted(results)]


def _lines(path: Path) -> list[str]:
    """Read the lines, and cut off half a line: the next would be written behind it."""
    data = path.read_bytes()
    whole, _, rest = data.decode().rpartition("\n")
    lines = whole.splitlines()
    if rest.startswith(_START) or _START.startswith(rest):
        # Truncating needs no room, which a full disk would not have for writing.
        os.truncate(path, data.rfind(b"\n") + 1)
    else:
        lines.append(rest)
    return lines
