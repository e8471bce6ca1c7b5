"""Classical rows of the psychophysics table: by t, χ², F and Fisher's z."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from percept.errors import RefusalError
from percept.inference.classical.intervals import Claim, interval_of
from percept.inference.classical.moments import Moments
from percept.inference.classical.variability import (
    Bounded,
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
from percept.study.basics import Array
from percept.study.data import Cell, Data
from percept.study.psychophysics.site import Site
from percept.study.responses import Trials


def classical_psychophysics(data: Data) -> Iterator[PsychophysicsRow]:
    """Yield the classical rows; of published limits those of means and SDs only."""
    for parameter in data.parameters:
        trials = _trials_if_any(data, parameter)
        sites = {}
        for cell in data.cells[data.asked.family]:
            if cell.parameter != parameter:
                continue
            site = _site(cell, data, trials)
            sites[cell.environment] = site
            if cell.moments is not None:
                yield from _moments_rows(site, cell.moments)
        if trials is not None:
            yield from _trial_rows(trials, sites)
            yield from _overall_rows(trials, sites)
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
        once = []
        for j, environment in enumerate(trials.environments):
            if trials.statistics.trial_df[j] == 0.0:
                once.append(environment)
        if not once:
            continue
        if len(once) < len(trials.environments):
            what += f" in {', '.join(once)}"
        yield Skipped(what, "it needs repeated trials")


def _trials_if_any(data: Data, *parameters: str) -> Trials | None:
    """Return trials of parameters as responses; None where they have none."""
    try:
        return data.trials(*parameters, partial=True)
    except RefusalError:
        return None


def _site(cell: Cell, data: Data, trials: Trials | None) -> Site:
    """Return the place of a cell's rows."""
    unit = 1.0
    if trials is not None and cell.environment in trials.environments:
        j = trials.environments.index(cell.environment)
        unit = float(trials.scale.unit[j])
    return Site(
        data=data,
        parameter=cell.parameter,
        environment=cell.environment,
        method="classical",
        n=0 if cell.moments is None else int(np.asarray(cell.moments.n)),
        response_unit=unit,
    )


def _moments_rows(site: Site, moments: Moments) -> Iterator[PsychophysicsRow]:
    """Yield rows of subjects' mean and SD."""
    asked = site.data.asked
    claim = Claim(level=asked.level, family=asked.family)
    mean = interval_of("mean", moments, claim)
    pse = Bounded(float(mean.estimate), float(mean.lower), float(mean.upper))
    yield site.row("pse", pse, site.quantity.unit)
    sd = float(moments.on_scale(asked.family).sd)
    bounded = sd_interval(sd / site.response_unit, site.n - 1.0, level=asked.level)
    yield from site.of_subjects(bounded)


def _trial_rows(data: Trials, sites: Mapping[str, Site]) -> Iterator[PsychophysicsRow]:
    """Yield rows of repeated trials, environment by environment."""
    counts = _trial_counts(data)
    statistics = data.statistics
    for j, environment in enumerate(data.environments):
        site = sites[environment]
        df = float(statistics.trial_df[j])
        if df == 0.0:
            continue
        level = site.data.asked.level
        root_square = abs(float(statistics.trial_rows[0, 0, j]))
        trial_sd = root_square / math.sqrt(df)
        bounded = sd_interval(trial_sd, df, level=level)
        yield from site.of_trials(bounded)
        present = counts[:, j] > 0
        means = statistics.cell_means[present, 0, j]
        no_scatter = trial_sd == 0.0 and np.ptp(means) == 0.0
        if no_scatter or len(means) < 2:
            continue
        own_counts = counts[present, j]
        unequal = bool(np.ptp(own_counts) > 0.0)
        squares = trial_mean_squares(means, own_counts, trial_sd)
        reliability = icc_consistency(squares, level=level)
        yield site.row("icc_1", reliability, approximate=unequal)


def _overall_rows(data: Trials, sites: Mapping[str, Site]) -> Iterator[PsychophysicsRow]:
    """Yield components of variance over all environments, of subjects who were in each."""
    table = data.statistics.cell_means[:, 0]
    complete = np.isfinite(table).all(axis=1)
    first = sites[data.environments[0]]
    level = first.data.asked.level
    overall = first.over_all(int(complete.sum()))
    try:
        squares = mean_squares(table[complete])
    except RefusalError:
        return
    shared = component_sd(squares, level=level)
    yield overall.sigma("sigma_u", shared, approximate=True)
    df = float(data.statistics.trial_df.sum())
    if df > 0.0:
        counts = _trial_counts(data)[complete]
        trial_squares = np.square(data.statistics.trial_rows[0, 0])
        trial_square = float(trial_squares.sum()) / df
        of_environments = _of_environments(squares, counts, trial_square, df)
        within = component_sd(of_environments, level=level)
        yield overall.sigma("sigma_w", within, approximate=True)
        trial = sd_interval(math.sqrt(trial_square), df, level=level)
        yield overall.sigma("sigma_e", trial)
    else:
        error_sd = math.sqrt(squares.error)
        within = sd_interval(error_sd, squares.error_df, level=level)
        yield overall.sigma("sigma_w", within)
    consistency = icc_consistency(squares, level=level)
    yield overall.row("icc_c1", consistency)
    agreement = icc_agreement(squares, level=level)
    yield overall.row("icc_a1", agreement, approximate=True)


def _of_environments(
    squares: MeanSquares, counts: Array, trial_square: float, trial_df: float
) -> MeanSquares:
    """Compare what subjects differ by within environments with what their trials differ by."""
    repeats = 1.0 / float(np.mean(1.0 / counts))
    return MeanSquares(
        subjects=repeats * squares.error,
        error=trial_square,
        columns=math.nan,
        n=round(squares.error_df) + 1,
        k=repeats,
        error_df=trial_df,
    )


def _trial_counts(data: Trials) -> Array:
    """Count the trials of each subject in each environment, (N, J)."""
    counts = np.zeros((len(data.subjects), len(data.environments)))
    np.add.at(counts, (data.subject, data.environment), 1.0)
    return counts


def _correlations(data: Data) -> Iterator[PsychophysicsRow]:
    """Yield the correlation of both quantities between subjects, environment by environment."""
    trials = _trials_if_any(data, *data.parameters)
    if trials is None:
        return
    cell_means = trials.statistics.cell_means
    for j, environment in enumerate(trials.environments):
        pairs = cell_means[:, :, j]
        complete = np.isfinite(pairs).all(axis=1)
        pairs = pairs[complete]
        try:
            bounded = correlation(pairs, level=data.asked.level)
        except RefusalError:
            continue
        site = Site(
            data=data,
            parameter=", ".join(data.parameters),
            environment=environment,
            method="classical",
            n=len(pairs),
            response_unit=1.0,
        )
        yield site.row("correlation", bounded, approximate=True)
