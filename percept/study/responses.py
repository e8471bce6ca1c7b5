"""Sessions become unit-free responses of the hierarchical model, and these quantities again."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Iterator, Sequence
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.errors import RefusalError, counted
from percept.inference.model.statistics import Resolution, Statistics, from_trials
from percept.results import Skipped
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.quantities import Quantities
from percept.study.basics import IF_BY_TRIAL, Array, References

#: Remainder of a regression over what is regressed, below which the two are in proportion. Values
#: printed to six figures leave 1e-6; at 5e-3 the sampler's 20 000 steps were too few already.
_PROPORTION = 1e-3
#: Hint where a quantity is compared by differences.
NO_SCALE = (
    'Set [model] scale.{}, which needs family = "normal", or leave the quantity out with'
    " [inference] parameters."
)


@dataclasses.dataclass(frozen=True, eq=False)
class ResponseScale:
    """The map between responses and parameters, per cell (parameter-major)."""

    log: bool  # Whether a response is a logarithm
    origin: Array  # (C,) What a response of zero stands for, in the quantity's unit
    unit: Array  # (C,) The quantity's units per response; 1 for logarithms

    @classmethod
    def of(cls, reference: Array, family: str) -> Self:
        """Take responses to references (C,), relative to them."""
        log = family == "lognormal"
        return cls(log, reference, np.ones_like(reference) if log else reference)

    @property
    def centre(self) -> Array:
        """What a response of zero stands for; of logarithms, its logarithm."""
        return np.log(self.origin) if self.log else self.origin

    def at(self, cell: int | list[int]) -> ResponseScale:
        """Return the scale of one cell, or of some."""
        return ResponseScale(self.log, self.origin[cell], self.unit[cell])

    def native(self, response: Array) -> Array:
        """Responses (..., C) in the units of their quantities."""
        if self.log:
            return self.origin * np.exp(self.unit * response)
        return self.origin + self.unit * response


@dataclasses.dataclass(frozen=True, eq=False)
class Trials:
    """Trials of all parameters asked for, as arrays."""

    response: Array  # (M, P) Unit-free responses
    subject: NDArray[np.intp]  # (M,) Codes
    environment: NDArray[np.intp]  # (M,) Codes
    parameters: tuple[str, ...]
    subjects: tuple[str, ...]  # Labels of the codes
    environments: tuple[str, ...]  # Labels of the codes
    statistics: Statistics  # What the density of the model needs of the trials
    scale: ResponseScale  # The way back
    skipped: tuple[Skipped, ...]  # Trials and environments that lack one of the parameters
    rows: pd.Index[int]  # Of the sessions' table, one for each trial


def decades(reference: Array) -> Array:
    """log10 of references over their geometric mean, (P, J); zero where one is not positive."""
    positive = (reference > 0).all(axis=1, keepdims=True)
    logs = np.log10(np.where(positive, reference, 1.0))
    return logs - logs.mean(axis=1, keepdims=True)


def trials(
    sessions: Sessions,
    scene: Scene,
    references: References,
    parameters: tuple[str, ...],
    *,
    partial: bool,
) -> Trials:
    """Take trials with all parameters asked for, unit-free.

    Where a quantity has a reference of zero or below its deviations are in the scene's scale, or in
    their own unit without one. `partial` leaves out environments whose values have no logarithm.
    """
    columns = [f"{p}_adj" for p in parameters]
    table = sessions.table.dropna(subset=columns)
    skipped = list(_incomplete(sessions, table, parameters))
    lognormal = scene.inference.family == "lognormal"
    is_low = (table[columns] <= 0).any(axis=1)
    not_positive = table.loc[is_low, "environment"].value_counts(sort=False)
    if lognormal and partial and len(not_positive) < table["environment"].nunique():
        # Without their environment: to leave out the lowest trials alone would bias what is left
        # there.
        table = table[~table["environment"].isin(not_positive.index)]
        why = "zero or negative values have no logarithm ({} there); "
        why += 'family = "normal" takes them, and [sessions] exclude leaves them out'
        for name, count in not_positive.items():
            skipped.append(Skipped(f"{name}, in the hierarchical model", why.format(count)))
    subject, labels = pd.factorize(table["subject"])
    subjects = tuple(labels)
    refuse_lone_subject(subjects)
    adjusted = table[columns].to_numpy(dtype=float)
    measured = set(table["environment"])
    environments = tuple(name for name in sessions.environments if name in measured)
    wrong = np.argwhere(adjusted <= 0.0)
    if lognormal and len(wrong):
        row, column = wrong[0].tolist()
        file, line = sessions.locate(int(table.index[row]))
        raise RefusalError(
            f"an adjustment of zero or below has no logarithm ({len(wrong)} in all).",
            file=file,
            row=line,
            column=columns[column],
            value=float(adjusted[row, column]),
            hint='Set family = "normal", or exclude the trial in the scene.',
        )
    if table.groupby("environment")["subject"].nunique().max() < 2:
        raise RefusalError("no environment has two subjects to tell users apart.", hint=IF_BY_TRIAL)
    reference = np.array([[references[p, name] for name in environments] for p in parameters])
    unit = np.ones_like(reference) if lognormal else reference.copy()
    for p, name in enumerate(parameters):
        if lognormal:
            present = {(name, where): references[name, where] for where in environments}
            refuse_no_ratio(present, sessions.quantities, hint=NO_SCALE.format(name))
        elif any(references[name, where] <= 0.0 for where in sessions.environments):
            unit[p] = scene.model.scale.get(name, 1.0)
    environment = pd.Index(environments).get_indexer(pd.Index(table["environment"]))
    reference_of_trial = reference[:, environment].T
    response = (adjusted - reference_of_trial) / unit[:, environment].T
    if lognormal:
        response = np.log(adjusted / reference_of_trial)
    statistics = from_trials(
        response,
        subject,
        environment,
        decades(reference),
        parameters=parameters,
        environments=environments,
        subjects=subjects,
    )
    return Trials(
        response=response,
        subject=subject,
        environment=environment,
        parameters=parameters,
        subjects=subjects,
        environments=environments,
        statistics=statistics,
        scale=ResponseScale(lognormal, reference.ravel(), unit.ravel()),
        skipped=tuple(skipped),
        rows=table.index,
    )


def _incomplete(
    sessions: Sessions, table: pd.DataFrame, parameters: tuple[str, ...]
) -> Iterator[Skipped]:
    """Say how many trials lack a parameter, and which environments have no trial with all."""
    dropped = len(sessions.table) - len(table)
    if not dropped:
        return
    lacking = " or ".join(sessions.quantities[p].label for p in parameters)
    lack = "it lacks" if dropped == 1 else "they lack"
    yield Skipped(f"{counted(dropped, 'trial')}, in the hierarchical model", f"{lack} {lacking}")
    needed = "both parameters" if len(parameters) == 2 else lacking
    measured = set(table["environment"])
    for name in sessions.environments:
        if name not in measured:
            yield Skipped(f"Bayesian intervals of {name}", f"no trial there has {needed}")


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
    quantities: Quantities,
    *,
    why: str = "which has no ratio",
    hint: str = "Leave the environment or the parameter out in the scene.",
) -> None:
    """Refuse a reference that is not positive."""
    for (parameter, environment), reference in references.items():
        if reference <= 0:
            raise RefusalError(
                f"the reference {quantities[parameter].label} of {environment} is {reference:g},"
                f" {why}.",
                column=f"{parameter}_ref",
                hint=hint,
            )


def resolution_of(trials: Trials, scene: Scene) -> Resolution | None:
    """Variance of rounding to a step, step²/12, as responses, in cells whose scatter it hides.

    RefusalError where these have no step.
    """
    steps = scene.model.resolution
    statistics = trials.statistics
    between, trial = lacking_scatter(statistics, steps, scene.quantities)
    if not (between.any() or trial.any()):
        return None
    unit = trials.scale.unit.reshape(between.shape)
    if trials.scale.log:
        typical = np.exp(np.nanmean(statistics.cell_means, axis=0))
        unit = trials.scale.origin.reshape(between.shape) * typical
    step = np.array([steps.get(p, 0.0) for p in statistics.parameters])
    variance = (step[:, None] / unit) ** 2 / 12.0
    # Elsewhere rounding is part of the scatter that is seen, and its variance would count twice.
    return Resolution(
        between=np.where(between, variance, 0.0), trial=np.where(trial, variance, 0.0)
    )


def lacking_scatter(
    statistics: Statistics, steps: Collection[str], quantities: Quantities
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Find cells (P, J) whose lack of scatter a step makes up for; or refuse.

    Scatter lacks between subjects and between trials: where all values of a quantity are equal, and
    where those of two are in proportion.
    """
    has_step = np.array([[parameter in steps] for parameter in statistics.parameters])
    means = statistics.cell_means - np.nanmean(statistics.cell_means, axis=0)
    trials = statistics.scatter.rows
    between = (statistics.sd == 0) & (statistics.df > 0)
    trial = (statistics.trial_squares == 0) & (statistics.trial_df > 0)
    for what, is_still in (
        ("all subjects made the same adjustments", between),
        ("no subject's trials differ", trial),
    ):
        for p, cells in enumerate(is_still & ~has_step):
            if not cells.any():
                continue
            quantity = quantities[statistics.parameters[p]]
            names = ", ".join(itertools.compress(statistics.environments, cells))
            raise RefusalError(
                f"{what} in {quantity.label} of {names}: zero scatter has no proper posterior.",
                column=f"{quantity.name}_adj",
                hint=(
                    f"Give the adjustment's step in {quantity.unit or 'its own unit'}: "
                    f"[model] resolution.{quantity.name}."
                ),
            )
    if len(statistics.parameters) < 2:
        return between, trial
    first, second = [quantities[parameter] for parameter in statistics.parameters]
    for what, (a, b), df, lacking in (
        ("the subjects' means", means.transpose(1, 2, 0), statistics.df.min(axis=0), between),
        ("a subject's trials", trials.transpose(0, 2, 1), statistics.trial_df, trial),
    ):
        if not _in_proportion(a, b, df):
            continue
        lacking |= df > 0
        if not has_step.any():
            raise RefusalError(
                f"{first.label} and {second.label} of {what} move in proportion, to within"
                f" {_PROPORTION:.1%}, in every environment: a correlation of one has no proper"
                " posterior.",
                column=f"{second.name}_adj",
                hint=(
                    "Analyse one of them, [inference] parameters, or give the steps: "
                    "[model] resolution."
                ),
            )
    return between & has_step, trial & has_step


def _in_proportion(a: Array, b: Array, df: Array) -> bool:
    """Say whether the rows of the scatter (J, n) of two quantities are multiples in every one."""
    informed = df >= 1.0
    # Near a correlation of one the density of such pairs grows as (1 - rho²)^(-(f - 1)/2) for every
    # environment's f degrees of freedom; from four such half powers on no prior of rho holds it.
    if (df[informed] - 1.0).sum() < 4.0:
        return False
    a = a[informed]
    b = b[informed]
    squares = np.nansum(a * a, axis=1) * np.nansum(b * b, axis=1)
    with np.errstate(invalid="ignore"):
        correlations = np.nansum(a * b, axis=1) / np.sqrt(squares)
    # What is left of a regression, over what is regressed, is the root of 1 - r².
    return bool(abs(correlations.mean()) >= np.sqrt(1.0 - _PROPORTION**2))
