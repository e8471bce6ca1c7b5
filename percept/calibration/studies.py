"""Studies of a plan by their numbers: each worked on once, its result kept line by line in a file."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from percept.errors import RefusalError, UsageError
from percept.files import exclusive
from percept.workers import Mapper, in_process

# How every line starts: what is left of one cut short is told from a file of something else.
_START = '{"plan": "'


class Checkpoint:
    """A file of JSON lines, one per study of a plan; lines of other plans stand beside them."""

    def __init__(self, path: str | os.PathLike[str] | None, plan: str, *, what: str) -> None:
        self._path = None if path is None else Path(path)
        self._plan, self._what = plan, what

    def read(self, studies: int) -> dict[int, dict[str, Any]]:
        """Read the results of the plan's first studies by index; cut off a last line that is not whole."""
        if self._path is None or not self._path.exists():
            return {}
        with exclusive(self._path.parent):
            lines = self._whole_lines(self._path)
        results = {}
        for row, line in enumerate(lines, start=1):
            try:
                result = json.loads(line)
                plan, index = result.pop("plan"), int(result.pop("index"))
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                raise self._strange(row) from error
            if not result:
                raise self._strange(row)
            if plan == self._plan and index < studies:
                results[index] = result
        return results

    def append(self, index: int, result: Mapping[str, Any]) -> None:
        """Write the result of study `index` behind the others."""
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        line = {"plan": self._plan, "index": index, **result}
        with exclusive(self._path.parent), self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def complete(
        self,
        study: Callable[[int], dict[str, Any]],
        studies: int,
        *,
        mapper: Mapper | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[dict[str, Any]]:
        """Return the results of all studies, those not kept yet by calling `study` on the workers.

        Studies that end in an error are told together, when all others are kept.
        """
        results = self.read(studies)
        missing = sorted(set(range(studies)) - results.keys())
        errors: dict[int, Exception] = {}
        for index, result in (mapper or in_process)(study, missing):
            if isinstance(result, Exception):
                errors[index] = result
                continue
            results[index] = result
            self.append(index, result)
            if progress:
                progress(len(results), studies)
        if errors:
            first = min(errors)
            raise RefusalError(
                f"{len(errors)} studies ended in an error; study {first}: "
                f"{type(errors[first]).__name__}: {errors[first]}",
                hint=(
                    "The others are kept where there is a checkpoint: the same run again tries"
                    " these only."
                ),
            ) from errors[first]
        return [results[index] for index in sorted(results)]

    def _whole_lines(self, path: Path) -> list[str]:
        """Read the lines, and cut off a last one that is not whole: the next would be written behind it."""
        try:
            data = path.read_bytes()
            whole, newline, rest = data.decode().rpartition("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(
                f"no file of {self._what} studies.", file=str(path), hint="Choose another folder."
            ) from error
        if rest:
            if not (rest.startswith(_START) or _START.startswith(rest)):
                raise self._strange(1 + whole.count("\n") + len(newline))
            # Truncating needs no room, which a full disk would not have for writing.
            os.truncate(path, data.rfind(b"\n") + 1)
        return whole.splitlines()

    def _strange(self, row: int) -> UsageError:
        return UsageError(f"not a line of {self._what} studies.", file=str(self._path), row=row)
