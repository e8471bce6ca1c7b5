"""Each subject against what the others predict: leave-one-out density, influence, outliers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.html import NotebookRecord
from percept.inference.checks.left_out import Loo, Predicted, leave_one_out, predict_left_out
from percept.inference.checks.predictive import STATISTICS, replicate, statistics_of
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import Progress
from percept.scene import Scene
from percept.sessions.values import UNITS
from percept.study.bayesian import Fit
from percept.study.posterior import thinned_points
from percept.study.streams import Stream, generator
from percept.study.units import NAMES

Array = NDArray[np.float64]
#: Chance of naming any outlier at all in a study the model holds for; shared over all that is looked at.
FALSE_ALARM = 0.05
#: Accuracy of sampling anew, in SDs of the log density; and the error, in nats, above which the log of its
#: mean stays rough.
_ACCURACY = 0.05
_ROUGH = 0.2
_REPLICATES = 4000


@dataclasses.dataclass(frozen=True, eq=False)
class SubjectChecks(NotebookRecord):
    """What leaving each subject out says."""

    elpd: float
    se: float
    good_k: float  # Pareto index up to which reweighting is trusted, with this many draws
    subjects: pd.DataFrame  # subject
    cells: pd.DataFrame  # subject, environment, parameter, value (mean adjusted value, N/m or N·s/m
    messages: tuple[str, ...]  # Influential subjects and outliers by name, with what to do


def check_subjects(
    fit: Fit,
    subjects: SubjectDensity,
    scene: Scene,
    *,
    progress: Callable[[Progress], None] | None = None,
) -> SubjectChecks:
    """Leave every subject out."""
    points, _ = thinned_points(fit)
    loo = leave_one_out(subjects, points, chains=len(fit.run.points))
    predicted = predict_left_out(subjects, loo.points, loo.weights)
    refitted = np.zeros(subjects.subjects, dtype=bool)
    refit = scene.checks is not None and scene.checks.refit
    if refit:
        loo, predicted, refitted = _refit(subjects, loo, predicted, scene, progress)
    return _tables(fit, subjects, loo, predicted, refitted, refit=refit)


def _refit(
    subjects: SubjectDensity,
    loo: Loo,
    predicted: Predicted,
    scene: Scene,
    progress: Callable[[Progress], None] | None,
) -> tuple[Loo, Predicted, NDArray[np.bool_]]:
    """Replace what reweighting cannot tell; a run that fails its gate changes nothing."""
    from percept.inference.checks.left_out import sample_without

    asked = scene.inference
    settings = Settings(
        tolerance=_ACCURACY, seed=asked.seed, walkers=asked.walkers, most_steps=asked.most_steps
    )
    pointwise, below, farther = loo.pointwise.copy(), predicted.below.copy(), predicted.farther.copy()
    done = np.zeros(subjects.subjects, dtype=bool)
    names = subjects.density.statistics.subjects
    for i in np.flatnonzero(loo.influential):
        anew = sample_without(subjects, int(i), names[i], settings, progress=progress)
        if anew is None:
            continue
        done[i] = anew.error <= _ROUGH
        pointwise[i] = anew.log_density
        even = np.full((len(anew.points), 1), 1.0 / len(anew.points))
        own = predict_left_out(subjects, anew.points, even, np.array([i]))
        below[i], farther[i] = own.below[0], own.farther[0]
    return dataclasses.replace(loo, pointwise=pointwise), Predicted(below, farther), done


def _tables(
    fit: Fit,
    subjects: SubjectDensity,
    loo: Loo,
    predicted: Predicted,
    refitted: NDArray[np.bool_],
    *,
    refit: bool,
) -> SubjectChecks:
    statistics = subjects.density.statistics
    table = pd.DataFrame(
        {
            "subject": list(statistics.subjects),
            "elpd": loo.pointwise,
            "pareto_k": loo.pareto_k,
            "influential": loo.influential,
            "refitted": refitted,
            "farther": predicted.farther,
            "outlier": predicted.farther < FALSE_ALARM / subjects.subjects,
        }
    )
    cells = _cells(fit, subjects, predicted)
    return SubjectChecks(
        loo.elpd, loo.se, loo.good_k, table, cells, tuple(_messages(table, cells, loo.good_k, refit=refit))
    )


def _cells(fit: Fit, subjects: SubjectDensity, predicted: Predicted) -> pd.DataFrame:
    statistics = subjects.density.statistics
    means = statistics.cell_means
    value = fit.prepared.scale.native(means.reshape(len(means), -1)).reshape(means.shape)
    rows: list[dict[str, Any]] = [
        {
            "subject": statistics.subjects[i],
            "environment": statistics.environments[j],
            "parameter": statistics.parameters[p],
            "value": value[i, p, j],
            "below": predicted.below[i, p, j],
        }
        for i, p, j in np.argwhere(np.isfinite(means)).tolist()
    ]
    table = pd.DataFrame(rows)
    tail = 2.0 * np.minimum(table["below"], 1.0 - table["below"])
    return table.assign(outlier=tail < FALSE_ALARM / len(table))


def _messages(table: pd.DataFrame, cells: pd.DataFrame, good_k: float, *, refit: bool) -> list[str]:
    found = []
    influential = table[table["influential"]]
    if len(influential):
        named = ", ".join(f"{row.subject} ({row.pareto_k:.2f})" for row in influential.itertuples())
        rough = ", ".join(influential.loc[~influential["refitted"], "subject"])
        found.append(
            f"Influential, with a Pareto index above {good_k:.2f}: {named}. The intervals rest on them more "
            "than on others: look at their sessions, and report the intervals with and without them."
        )
        if rough and refit:
            found.append(
                f"The predictive density of {rough} stays rough, though sampled anew: hardly any spread that "
                "the others allow explains them."
            )
        elif rough:
            found.append(
                f"What is said of leaving out {rough} is rough: have the posterior sampled without them "
                "(--refit)."
            )
    found += [
        f"{row.subject} lies far from what the others predict, all cells together: as far or farther with "
        f"probability {row.farther:.1e}. See whether the session went wrong before believing the spread."
        for row in table[table["outlier"]].itertuples()
    ]
    for row in cells[cells["outlier"]].itertuples():
        side = "below" if float(row.below) < 0.5 else "above"  # type: ignore[arg-type]
        parameter = str(row.parameter)
        found.append(
            f"{row.subject} set {NAMES[parameter]} in {row.environment} to {row.value:.4g} "
            f"{UNITS[parameter]}, far {side} what the others predict."
        )
    return found


def check_statistics(fit: Fit, subjects: SubjectDensity, scene: Scene) -> pd.DataFrame:
    """Compare each cell's mean, SD and farthest subject with those of new studies from the posterior."""
    points, _ = thinned_points(fit)
    chosen = points[:: max(1, len(points) // _REPLICATES)]
    rng = generator(scene.inference.seed, Stream.CHECKED_STATISTICS)
    drawn = replicate(subjects, chosen, rng)
    statistics = subjects.density.statistics
    observed = statistics_of(statistics.cell_means)
    tail = 0.5 * (1.0 - scene.inference.level)
    lower, upper = np.quantile(drawn, [tail, 1.0 - tail], axis=0)
    above = (drawn > observed).mean(axis=0)
    rows = []
    for j, environment in enumerate(statistics.environments):
        for p, parameter in enumerate(statistics.parameters):
            for s, name in enumerate(STATISTICS):
                at = (s, p, j)
                if np.isfinite(observed[at]):
                    rows.append(
                        {
                            "environment": environment,
                            "parameter": parameter,
                            "statistic": name,
                            "observed": observed[at],
                            "lower": lower[at],
                            "upper": upper[at],
                            "above": above[at],
                            "unusual": bool(not lower[at] <= observed[at] <= upper[at]),
                        }
                    )
    return pd.DataFrame(rows)
