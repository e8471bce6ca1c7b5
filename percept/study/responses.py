"""From sessions to the unit-free responses of the hierarchical model, and back to N/m and N·s/m."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, counted
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import NAMES, Array, References, Skipped


@dataclasses.dataclass(frozen=True, eq=False)
class ResponseScale:
    """The map between responses and parameters, per cell (parameter-major)."""

    log: bool  # Whether a response is a logarithm
    origin: Array  # (C,) N/m or N·s/m of a response of zero
    unit: Array  # (C,) N/m or N·s/m per response; 1 for logarithms

    @classmethod
    def of(cls, reference: Array, family: str, unit: Array | None = None) -> Self:
        """Take responses to references of any shape; relative deviations are in `unit`, or in references."""
        if family == "lognormal":
            return cls(True, reference.ravel(), np.ones(reference.size))
        return cls(False, reference.ravel(), (reference if unit is None else unit).ravel())

    def of_cells(self, cells: Sequence[int]) -> Self:
        """Return the map of some of the cells."""
        return dataclasses.replace(self, origin=self.origin[cells], unit=self.unit[cells])

    def native(self, response: Array) -> Array:
        """Responses (..., C) in N/m or N·s/m."""
        if self.log:
            return self.origin * np.exp(self.unit * response)
        return self.origin + self.unit * response


@dataclasses.dataclass(frozen=True, eq=False)
class Trials:
    """Trials of all parameters asked for, as arrays."""

    response: Array  # (M, P) Unit-free responses
    subject: NDArray[np.intp]  # (M,) Codes
    environment: NDArray[np.intp]  # (M,) Codes
    subjects: tuple[str, ...]  # Labels of the codes
    environments: tuple[str, ...]  # Labels of the codes
    reference: Array  # (P, J) N/m or N·s/m
    x: Array  # (P, J) log10 of each reference over their geometric mean
    scale: ResponseScale  # The way back
    skipped: tuple[Skipped, ...]  # Trials and environments that lack one of the parameters


def references(sessions: Sessions, parameters: tuple[str, ...], environments: tuple[str, ...]) -> Array:
    """Return the reference of each parameter in each environment, shape (P, J), N/m or N·s/m."""
    table = sessions.table
    if sessions.form == "summary":
        keyed = table.set_index(["parameter", "environment"])["reference"]
        return np.array([[float(keyed.get((p, e), np.nan)) for e in environments] for p in parameters])
    first = table.groupby("environment", sort=False)[[f"{p}_ref" for p in parameters]].first()
    return first.loc[list(environments)].to_numpy(dtype=float).T


def decades(reference: Array) -> Array:
    """log10 of references over their geometric mean, shape (P, J); zeros where one is not positive."""
    positive = (reference > 0).all(axis=1, keepdims=True)
    logs = np.log10(np.where(positive, reference, 1.0))
    return logs - logs.mean(axis=1, keepdims=True)


def trials(sessions: Sessions, scene: Scene, parameters: tuple[str, ...]) -> Trials:
    """Take the trials with all parameters asked for, in unit-free responses."""
    columns = [f"{p}_adj" for p in parameters]
    complete = sessions.table[columns].notna().all(axis=1)
    table = sessions.table[complete]
    subjects = tuple(dict.fromkeys(table["subject"]))
    present = set(table["environment"])
    environments = tuple(name for name in sessions.environments if name in present)
    refuse_lone_subject(subjects)
    adjusted = table[columns].to_numpy(dtype=float)
    lognormal = scene.inference.family == "lognormal"
    if lognormal:
        _refuse_not_positive(sessions, table.index.to_numpy(), adjusted, columns)
    reference = references(sessions, parameters, environments)
    codes = {name: at for at, name in enumerate(environments)}
    environment = np.array([codes[name] for name in table["environment"]], dtype=np.intp)
    subject = table["subject"].map({s: i for i, s in enumerate(subjects)}).to_numpy(dtype=np.intp)
    unit = _units(reference, parameters, environments, scene)
    at = reference[:, environment].T
    return Trials(
        response=np.log(adjusted / at) if lognormal else (adjusted - at) / unit[:, environment].T,
        subject=subject,
        environment=environment,
        subjects=subjects,
        environments=environments,
        reference=reference,
        x=decades(reference),
        scale=ResponseScale.of(reference, scene.inference.family, unit),
        skipped=_incomplete(sessions, parameters, environments, int((~complete).sum())),
    )


def _incomplete(
    sessions: Sessions, parameters: tuple[str, ...], kept: tuple[str, ...], dropped: int
) -> tuple[Skipped, ...]:
    """Name the trials that lack a parameter, and the environments they leave without any."""
    if not dropped:
        return ()
    lacking = " or ".join(NAMES[p] for p in parameters)
    lack = "it lacks" if dropped == 1 else "they lack"
    needed = "both parameters" if len(parameters) == 2 else lacking
    return (
        Skipped(f"{counted(dropped, 'trial')}, in the hierarchical model", f"{lack} {lacking}"),
        *(
            Skipped(f"Bayesian intervals of {environment}", f"no trial there has {needed}")
            for environment in sessions.environments
            if environment not in kept
        ),
    )


def _units(
    reference: Array, parameters: tuple[str, ...], environments: tuple[str, ...], scene: Scene
) -> Array:
    """Return the unit of a response: the reference, or the scene's scale where a reference is zero."""
    unit = reference.copy()
    scales = {str(name): scale for name, scale in scene.model.scale.items()}
    for p, name in enumerate(parameters):
        if np.all(reference[p] > 0):
            continue
        if scene.inference.family == "lognormal" or name not in scales:
            refuse_no_ratio(
                {(name, e): value for e, value in zip(environments, reference[p].tolist(), strict=True)},
                hint=f'Set family = "normal" and [model] scale.{name}, or analyse the other parameter '
                f"alone with [inference] parameters.",
            )
        unit[p] = scales[name]
    return unit


def refuse_lone_subject(subjects: Sequence[str]) -> None:
    """Refuse a study of fewer than two subjects."""
    if len(subjects) < 2:
        found = f"only one, {subjects[0]!r}, is" if subjects else "none is"
        raise RefusalError(
            f"at least two subjects are needed to tell users apart; {found} in the data.",
            hint="Add the sessions of more subjects.",
        )


def refuse_no_ratio(
    references: References,
    *,
    why: str = "which has no ratio",
    hint: str = "Leave the environment or the parameter out in the scene.",
) -> None:
    """Refuse a reference that is not positive."""
    for (parameter, environment), reference in references.items():
        if reference <= 0:
            raise RefusalError(
                f"the reference {NAMES[parameter]} of {environment} is {reference:g}, {why}.",
                column=f"{parameter}_ref",
                hint=hint,
            )


def _refuse_not_positive(
    sessions: Sessions, index: NDArray[np.generic], adjusted: Array, columns: list[str]
) -> None:
    wrong = np.argwhere(adjusted <= 0)
    if len(wrong):
        row, column = wrong[0]
        file, line = sessions.locate(int(index[row]))
        raise RefusalError(
            f"an adjustment of zero or below has no logarithm ({len(wrong)} in all).",
            file=file,
            row=line,
            column=columns[column],
            value=float(adjusted[row, column]),
            hint='Set family = "normal", or exclude the trial in the scene.',
        )
