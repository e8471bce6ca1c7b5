"""Classical rows of the psychophysics table: by t, χ², F and Fisher's z."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from percept.errors import RefusalError
from percept.inference.classical.variability import (
    MeanSquares,
    component_sd,
    correlation,
    icc_agreement,
    icc_consistency,
    mean_squares,
    sd_interval,
    trial_mean_squares,
)
from percept.results import PsychophysicsRow, Skipped
from percept.study.data import Cell, Data
from percept.study.psychophysics.rows import Measured
from percept.study.responses import Trials


def classical_psychophysics(data: Data) -> Iterator[PsychophysicsRow]:
    """Yield the classical rows; of published limits those of SDs only."""
    asked = data.asked
    for parameter in data.parameters:
        trials = _trials_if_any(data, parameter)
        by_environment = {}
        for cell in data.cells[data.asked.family]:
            if cell.parameter != parameter:
                continue
            measured = _measured(cell, data, trials)
            by_environment[cell.environment] = measured
            if cell.moments is not None:
                sd = float(cell.moments.on_scale(asked.family).sd) / measured.unit
                bounded = sd_interval(sd, measured.n - 1.0, level=asked.level)
                yield from measured.rows("sd_subjects", bounded)
        if trials is not None:
            for j, environment in enumerate(trials.environments):
                yield from _of_trials(by_environment[environment], trials, j)
            yield from _over_all(by_environment[trials.environments[0]], trials)
    if len(data.parameters) == 2:
        yield from _correlations(data)


def absent_jnds(data: Data) -> Iterator[Skipped]:
    """Name the quantities and environments without a JND, and say why."""
    for parameter in data.parameters:
        what = f"JND of {data.quantities[parameter].label}"
        try:
            trials = data.trials(parameter, partial=True)
        except RefusalError as refused:
            yield Skipped(what, str(refused))
            continue
        names = trials.environments
        most = trials.counts.max(axis=0).tolist()
        once = [name for name, count in zip(names, most, strict=True) if count == 1.0]
        if once:
            where = "" if len(once) == len(names) else f" in {', '.join(once)}"
            yield Skipped(what + where, "it needs repeated trials")


def _trials_if_any(data: Data, *parameters: str) -> Trials | None:
    """Return trials of parameters as responses; None where they have none."""
    try:
        return data.trials(*parameters, partial=True)
    except RefusalError:
        return None


def _measured(cell: Cell, data: Data, trials: Trials | None) -> Measured:
    """Return where a cell's rows belong."""
    unit = 1.0
    if trials is not None and cell.environment in trials.environments:
        unit = float(trials.scale.unit[trials.environments.index(cell.environment)])
    return Measured(
        data=data,
        method="classical",
        parameter=cell.parameter,
        environment=cell.environment,
        n=0 if cell.moments is None else int(np.asarray(cell.moments.n)),
        unit=unit,
    )


def _of_trials(measured: Measured, trials: Trials, j: int) -> Iterator[PsychophysicsRow]:
    """Yield rows of repeated trials in environment j."""
    level = measured.data.asked.level
    df = float(trials.statistics.trial_df[j])
    if df == 0.0:
        return
    trial_sd = abs(float(trials.statistics.trial_rows[0, 0, j])) / math.sqrt(df)
    yield from measured.rows("sigma_e", sd_interval(trial_sd, df, level=level))
    present = trials.counts[:, j] > 0
    means = trials.statistics.cell_means[present, 0, j]
    no_scatter = trial_sd == 0.0 and np.ptp(means) == 0.0
    if no_scatter or len(means) < 2:
        return
    counts = trials.counts[present, j]
    reliability = icc_consistency(trial_mean_squares(means, counts, trial_sd), level=level)
    yield from measured.rows("icc_1", reliability, approximate=bool(np.ptp(counts) > 0.0))


def _over_all(measured: Measured, trials: Trials) -> Iterator[PsychophysicsRow]:
    """Yield components of variance over all environments, of subjects who were in each."""
    level = measured.data.asked.level
    table = trials.statistics.cell_means[:, 0]
    complete = np.isfinite(table).all(axis=1)
    try:
        squares = mean_squares(table[complete])
    except RefusalError:
        return
    overall = dataclasses.replace(measured, environment=None, n=int(complete.sum()))
    yield from overall.rows("sigma_u", component_sd(squares, level=level), approximate=True)
    df = float(trials.statistics.trial_df.sum())
    if df > 0.0:
        trial_square = float(np.square(trials.statistics.trial_rows[0, 0]).sum()) / df
        # What subjects differ by within environments, against what their trials differ by.
        repeats = 1.0 / float(np.mean(1.0 / trials.counts[complete]))
        within_environments = MeanSquares(
            subjects=repeats * squares.error,
            error=trial_square,
            columns=math.nan,
            n=round(squares.error_df) + 1,
            k=repeats,
            error_df=df,
        )
        within = component_sd(within_environments, level=level)
        yield from overall.rows("sigma_w", within, approximate=True)
        yield from overall.rows("sigma_e", sd_interval(math.sqrt(trial_square), df, level=level))
    else:
        within = sd_interval(math.sqrt(squares.error), squares.error_df, level=level)
        yield from overall.rows("sigma_w", within)
    yield from overall.rows("icc_c1", icc_consistency(squares, level=level))
    yield from overall.rows("icc_a1", icc_agreement(squares, level=level), approximate=True)


def _correlations(data: Data) -> Iterator[PsychophysicsRow]:
    """Yield the correlation of both quantities between subjects, environment by environment."""
    trials = _trials_if_any(data, *data.parameters)
    if trials is None:
        return
    for j, environment in enumerate(trials.environments):
        pairs = trials.statistics.cell_means[:, :, j]
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
        # Two pairs lie on a line, whatever they are.
        if len(pairs) < 3:
            continue
        try:
            bounded = correlation(pairs, level=data.asked.level)
        except RefusalError:
            continue
        measured = Measured(
            data=data,
            method="classical",
            parameter=", ".join(data.parameters),
            environment=environment,
            n=len(pairs),
        )
        yield from measured.rows("correlation", bounded, approximate=True)
