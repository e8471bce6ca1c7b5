"""Who adjusted what, how often: the design a simulated study is drawn for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError

Parameter = Literal["k", "b"]
PARAMETERS: tuple[Parameter, ...] = ("k", "b")


@dataclass(frozen=True, eq=False)
class Design:
    """Subjects × environments, with the number of trials in every cell.

    Parameters
    ----------
    references : (J, P) array_like
        Reference of each environment, positive: stiffness in N/m, damping in N·s/m, in the order of
        `parameters`.
    trials : (I, J) array_like of int
        Trials of each subject in each environment; 0 leaves the cell out.
    parameters : tuple of {"k", "b"}, optional
        What the subjects adjust.
    environments : tuple of str, optional
        Names of the environments; VE1, VE2, … when left out.

    Raises
    ------
    UsageError
        Shapes that do not agree, a reference that is not positive, a negative or broken count, a
        subject or an environment without a trial, repeated names.
    """

    references: NDArray[np.float64]
    trials: NDArray[np.int64]
    parameters: tuple[Parameter, ...] = PARAMETERS
    environments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        references = np.array(self.references, dtype=float)
        counts = np.array(self.trials)
        parameters = tuple(self.parameters)
        if parameters not in (("k", "b"), ("k",), ("b",)):
            raise UsageError(
                "parameters must be ('k', 'b'), ('k',) or ('b',).", key="parameters", value=parameters
            )
        if references.ndim != 2 or references.shape[0] == 0 or references.shape[1] != len(parameters):
            raise UsageError(
                f"references must have one row per environment and {len(parameters)} column(s).",
                key="references",
                value=references.shape,
            )
        if not np.all(np.isfinite(references) & (references > 0)):
            bad = references[~(np.isfinite(references) & (references > 0))][0]
            raise UsageError(
                "every reference must be positive: responses are ratios to it.",
                key="references",
                value=float(bad),
            )
        if counts.ndim != 2 or counts.shape[0] == 0 or counts.shape[1] != references.shape[0]:
            raise UsageError(
                f"trials must have one row per subject and {references.shape[0]} column(s), one per "
                "environment.",
                key="trials",
                value=counts.shape,
            )
        if not np.issubdtype(counts.dtype, np.integer) or counts.min() < 0:
            raise UsageError("trials must be whole numbers, none negative.", key="trials")
        for axis, what in ((1, "subject"), (0, "environment")):
            empty = np.flatnonzero(counts.sum(axis=axis) == 0)
            if empty.size:
                raise UsageError(
                    f"{what} number {empty[0] + 1} has no trial at all.",
                    key="trials",
                    hint="Leave it out of the design.",
                )
        names = tuple(self.environments) or tuple(f"VE{j}" for j in range(1, len(references) + 1))
        if len(names) != len(references) or len(set(names)) != len(names):
            raise UsageError(
                f"environments must be {len(references)} different names.", key="environments", value=names
            )
        references.setflags(write=False)
        counts = counts.astype(np.int64)
        counts.setflags(write=False)
        for field, value in (
            ("references", references),
            ("trials", counts),
            ("parameters", parameters),
            ("environments", names),
        ):
            object.__setattr__(self, field, value)

    @classmethod
    def balanced(
        cls,
        references: ArrayLike,
        *,
        subjects: int,
        trials: int = 1,
        parameters: tuple[Parameter, ...] = PARAMETERS,
        environments: tuple[str, ...] = (),
    ) -> Design:
        """Every subject meets every environment equally often.

        Parameters
        ----------
        references : (J, P) array_like
            As in `Design`.
        subjects : int
            Number of subjects.
        trials : int, optional
            Trials per cell.
        parameters, environments
            As in `Design`.

        Returns
        -------
        Design
            With `trials` in every cell.

        Raises
        ------
        UsageError
            No subject, or as `Design`.
        """
        if subjects < 1:
            raise UsageError("a study needs at least one subject.", key="subjects", value=subjects)
        table = np.asarray(references, dtype=float)
        environments_count = table.shape[0] if table.ndim else 0
        counts = np.full((subjects, environments_count), trials)
        return cls(table, counts, parameters=parameters, environments=environments)

    @property
    def subjects(self) -> tuple[str, ...]:
        """Names of the subjects, I of them: S01, S02 …, zero-padded so that they sort."""
        width = max(2, len(str(len(self.trials))))
        return tuple(f"S{i:0{width}d}" for i in range(1, len(self.trials) + 1))

    @property
    def decades(self) -> NDArray[np.float64]:
        """x_jp = log10(reference / geometric mean of the references), (J, P), in decades."""
        logs = np.log10(self.references)
        return logs - logs.mean(axis=0)

    @property
    def repeated(self) -> bool:
        """Whether any cell holds more than one trial, so that trial scatter can be told apart."""
        return bool(self.trials.max() > 1)
