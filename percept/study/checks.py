"""Checks of the hierarchical fit for the analyst: its subjects, its data and its priors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from percept.boundary.shares import Users
from percept.errors import RefusalError
from percept.inference.left_out import LeftOut as Predictions
from percept.inference.left_out import SubjectDensity
from percept.inference.predictive import (
    STATISTICS,
    Loo,
    Predicted,
    intervals_left_out,
    leave_one_out,
    new_studies,
    predict_left_out,
    smoothed_subjects,
    statistics_of,
)
from percept.results import (
    MOST_SHOWN,
    CellOutlier,
    Checks,
    IntervalWithout,
    LeftOut,
    PredictiveCheck,
    Skipped,
    SubjectCheck,
)
from percept.sessions.quantities import Quantities
from percept.study.basics import Array, Stream, generator, known
from percept.study.fit import Fit

#: Chance of naming any outlier at all in a study the model holds for; shared over all that is
#: looked at.
FALSE_ALARM = 0.05
_REPLICATES = 4000


def model_checks(fit: Fit) -> Checks | Skipped:
    """Check a fit against its data and priors; or say why not: its intervals stand all the same."""
    subjects = fit.subjects
    if isinstance(subjects, Skipped):
        return subjects
    left = fit.left_out
    try:
        loo = leave_one_out(subjects, left)
    except RefusalError as refused:
        return Skipped("checks of the hierarchical model", refused.message.rstrip("."))
    predicted = predict_left_out(subjects, left, loo.weights)
    return Checks(
        normality=fit.data.normality,
        loo=subject_tables(fit, subjects, loo, predicted),
        without=tuple(_intervals_without(fit, loo, left)),
        statistics=tuple(_statistics(fit, subjects)),
    )


def _intervals_without(fit: Fit, loo: Loo, left: Predictions) -> Iterator[IntervalWithout]:
    """Yield each average user's interval without each subject in turn, by weighted draws."""
    shown = fit.environments[:MOST_SHOWN]
    cells = [cell for cell in fit.column if cell[1] in shown]
    columns = [fit.column[cell] for cell in cells]
    found = intervals_left_out(left, loo.weights, columns, fit.data.asked.level)
    ends = np.where(loo.trusted[:, None], fit.scale.at(columns).native(found), np.nan)
    for c, (parameter, environment) in enumerate(cells):
        lower, estimate, upper = [tuple(map(known, end)) for end in ends[:, :, c].tolist()]
        yield IntervalWithout(environment, parameter, estimate, lower, upper)


def weights_without(fit: Fit, users: Mapping[str, Users]) -> dict[str, Array]:
    """Weights of the first S draws of users without each subject, (S, N), by their environment.

    They are one over the density of the subject's data given scales, locations and the other
    subjects; NaN of subjects without whom they cannot be trusted. There are none of a model that
    knows no subjects.
    """
    subjects = fit.subjects
    if isinstance(subjects, Skipped):
        return {}
    left = fit.left_out
    points = fit.shuffled[: len(left.log_density)]
    found: dict[str, Array] = {}
    if not np.isfinite(left.log_density).all():
        return found
    laws = subjects.density.joint(points, subjects.density.pair_rows)
    for environment, of_environment in users.items():
        j = fit.environments.index(environment)
        scale = fit.scale.at(fit.pair(environment))
        drawn = of_environment.mean.T[: len(points)]
        responses = (drawn - scale.centre) / scale.unit
        of_all = _log_normal(responses - laws.mean[:, j], laws.location[:, j])
        without = np.empty((*left.log_density.shape, 2, 2))
        without[..., 0, 1] = without[..., 1, 0] = left.covariance[..., j]
        without[..., [0, 1], [0, 1]] = np.square(left.location_sd[..., j])
        of_others = _log_normal(responses[:, None] - left.location[..., j], without)
        loo = smoothed_subjects(left.log_density + of_all[:, None] - of_others)
        found[environment] = np.where(loo.trusted, loo.weights, np.nan)
    return found


def _log_normal(deviation: Array, covariance: Array) -> Array:
    """Log density of pairs (..., 2) of a normal law, but for a constant."""
    solved = np.linalg.solve(covariance, deviation[..., None])[..., 0]
    _, log_determinant = np.linalg.slogdet(covariance)
    return -0.5 * ((deviation * solved).sum(axis=-1) + log_determinant)


def subject_tables(
    fit: Fit,
    subjects: SubjectDensity,
    loo: Loo,
    predicted: Predicted,
) -> LeftOut:
    """Name the subjects and cells that lie far from the others."""
    statistics = subjects.density.statistics
    names = statistics.subjects
    outliers = predicted.farther < FALSE_ALARM / len(names)
    farther = predicted.farther.tolist()
    checks = list(map(SubjectCheck, names, loo.pareto_k.tolist(), farther, outliers.tolist()))
    means = statistics.cell_means
    by_cell = means.reshape(len(means), -1)
    value = fit.scale.native(by_cell).reshape(means.shape)
    cells = []
    present = np.argwhere(np.isfinite(means)).tolist()
    for i, p, j in present:
        below = float(predicted.below[i, p, j])
        if 2.0 * min(below, 1.0 - below) < FALSE_ALARM / len(present):
            parameter = statistics.parameters[p]
            environment = statistics.environments[j]
            amount = float(value[i, p, j])
            cells.append(CellOutlier(names[i], environment, parameter, amount, below))
    return LeftOut(
        good_k=loo.good_k,
        subjects=tuple(checks),
        cells=tuple(cells),
        messages=tuple(_messages(checks, cells, fit.data.quantities)),
    )


def _messages(
    subjects: Sequence[SubjectCheck],
    cells: Sequence[CellOutlier],
    quantities: Quantities,
) -> Iterator[str]:
    """Say which subjects lie far off."""
    for check in subjects:
        if check.outlier:
            yield (
                f"{check.subject} is an outlier: so far off, or farther, with a probability of"
                f" {100.0 * check.farther:.2g} %. Check that session."
            )
    for cell in cells:
        side = "below" if cell.below < 0.5 else "above"
        quantity = quantities[cell.parameter]
        yield (
            f"{cell.subject} set {quantity.label} in {cell.environment} to "
            f"{quantity.amount(cell.value)}, far {side} what the others predict."
        )


def _statistics(fit: Fit, subjects: SubjectDensity) -> Iterator[PredictiveCheck]:
    """Compare each cell's mean, SD and farthest subject with new studies from the posterior."""
    stride = max(1, len(fit.points) // min(_REPLICATES, subjects.most_draws))
    rng = generator(fit.data.asked.seed, Stream.CHECKED_STATISTICS)
    studies = new_studies(subjects, fit.points[::stride], rng)
    drawn = np.concatenate([statistics_of(cell_means) for cell_means in studies])
    statistics = subjects.density.statistics
    observed = statistics_of(statistics.cell_means)
    above = (drawn > observed).mean(axis=0)
    # Shared over all checks, so that a right model seldom alarms, however many cells it has. The
    # study itself is one more: beyond all S replicates it has a probability of 1/S or less.
    checks = np.count_nonzero(np.isfinite(observed))
    tail = np.minimum(above, 1.0 - above) + 1.0 / len(drawn)
    unusual = 2.0 * checks * tail < FALSE_ALARM
    for j, p, s in np.argwhere(np.isfinite(observed).transpose(2, 1, 0)).tolist():
        index = (s, p, j)
        yield PredictiveCheck(
            environment=statistics.environments[j],
            parameter=statistics.parameters[p],
            statistic=STATISTICS[s],
            above=float(above[index]),
            unusual=bool(unusual[index]),
        )
