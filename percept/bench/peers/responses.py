"""A study as plain arrays: what a user of a general sampler would hand to it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from percept.errors import UsageError

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """Unit-free responses of one study without repeated trials; both parameters."""

    response: Array  # (M, 2) log(adjusted/reference) of k and b, one row per trial
    subject: NDArray[np.intp]  # (M,)
    environment: NDArray[np.intp]  # (M,)
    decades: Array  # (2, J) log10 of each reference over the geometric mean of its parameter's references

    @property
    def subjects(self) -> int:
        """Number of subjects."""
        return int(self.subject.max()) + 1

    @property
    def environments(self) -> int:
        """Number of environments."""
        return self.decades.shape[1]

    @classmethod
    def of_sessions(cls, path: str | Path) -> Self:
        """Read a study."""
        from percept.scene import Scene
        from percept.sessions import read_sessions
        from percept.study.responses import trials

        data = trials(read_sessions(path), Scene(), ("k", "b"))
        cells = np.stack([data.subject, data.environment], axis=1)
        if len(np.unique(cells, axis=0)) < len(cells):
            raise UsageError(
                "a subject has several trials in one environment; the models compared have no trial level.",
                file=str(path),
                hint="Compare on a study with one trial per subject and environment.",
            )
        return cls(data.response, data.subject, data.environment, data.x)

    def save(self, path: str | Path) -> None:
        """Write an .npz file, so that a peer's process needs numpy alone to start."""
        np.savez(path, **{field.name: getattr(self, field.name) for field in dataclasses.fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Undo `save`."""
        with np.load(path) as stored:
            return cls(**{field.name: stored[field.name] for field in dataclasses.fields(cls)})
