"""Whether a study's trials carry a trial SD for every subject, or why all subjects share one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from percept.results import Skipped
from percept.scene import Scene
from percept.study.basics import Array
from percept.study.responses import Trials

#: Subjects beyond which their own trial SDs take the sampler too long to be the default.
_MOST_SUBJECTS = 60
#: Trial degrees of freedom of the median subject: with fewer, one SD is known to a quarter at best.
_LEAST_TRIAL_DF = 8


def own_trial_sds(data: Trials, scene: Scene) -> bool | Skipped:
    """Say whether subjects have trial SDs of their own, and why not where they repeat trials."""
    if not data.statistics.repeats:
        return False
    why_not = _why_not(data, scene)
    if not why_not:
        return True
    what = " and ".join(scene.quantities[p].label for p in data.parameters)
    return Skipped(f"subjects' own trial SDs of {what}", why_not)


def _why_not(data: Trials, scene: Scene) -> str:
    """Say why all subjects share one trial SD; empty where each has one of their own."""
    table = scene.model
    setting = table.subjects_trial_sd
    if setting is False:
        return "[model] subjects_trial_sd = false"
    if setting == "auto" and (table.common_spread or not table.subject_effect):
        return "they do not go with [model] common_spread, nor with subject_effect = false"
    why = "the study has one environment" if len(data.environments) == 1 else _no_scatter(data)
    if setting == "auto" and not why and not table.precision:
        why = _why_not_by_default(data)
        why = why and f"{why}; [model] subjects_trial_sd = true computes them"
    return why


def _why_not_by_default(data: Trials) -> str:
    """Say why subjects share one trial SD unless the scene asks for more; empty if they do not."""
    if len(data.subjects) > _MOST_SUBJECTS:
        return f"the study has more than {_MOST_SUBJECTS} subjects"
    if np.median(_trial_df(data).sum(axis=1)) < _LEAST_TRIAL_DF:
        return f"half of the subjects repeat a trial fewer than {_LEAST_TRIAL_DF} times"
    return ""


def _trial_df(data: Trials) -> Array:
    """Count the trials of each subject in each cell beyond the first, (N, J)."""
    return np.maximum(data.counts - 1.0, 0.0)


def _no_scatter(data: Trials) -> str:
    """Say where repeats are so much alike that a trial SD has no proper posterior, or nothing."""
    df = _trial_df(data)
    scatters = _scatters(data)
    repeats = df.sum(axis=1) > 0.0
    steady = np.flatnonzero(repeats & ~np.all(scatters.any(axis=1), axis=1))
    if steady.size:
        names = ", ".join(data.subjects[i] for i in steady)
        return f"the repeats of {names} are all alike, and a trial SD of zero has no posterior"
    for p in range(len(data.parameters)):
        if (vanishing := _vanishing(df, scatters[:, :, p])).size:
            names = ", ".join(data.environments[j] for j in vanishing)
            return f"most repeats in {names} are alike, and trial SDs of zero have no posterior"
    return ""


def _scatters(data: Trials) -> NDArray[np.bool_]:
    """Say in which cells the repeats of a subject differ, by quantity, (N, J, P)."""
    # Values, not squares about their mean: rounding of the mean is no scatter.
    smallest = np.full((*data.counts.shape, len(data.parameters)), np.inf)
    largest = -smallest
    np.minimum.at(smallest, (data.subject, data.environment), data.response)
    np.maximum.at(largest, (data.subject, data.environment), data.response)
    scatters = largest > smallest
    # A cell in which no repeats differ is refused, unless the resolution stands in for scatter.
    return scatters | ~scatters.any(axis=0)


def _vanishing(df: Array, scatters: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the cells whose SDs the likelihood of one quantity drives to zero; none if bounded.

    The log SD of subject i in cell j is a_j + phi_i, and n trials beyond the first that do not
    scatter have the log likelihood -n (a_j + phi_i). It grows without bound along a direction in
    which no sum falls where trials scatter, and the sum over all trials does.
    """
    subject, cell = np.nonzero(df)
    groups = np.arange(len(subject))
    sums = np.zeros((len(subject), sum(df.shape)))
    sums[groups, subject] = 1.0
    sums[groups, len(df) + cell] = 1.0
    scatter = scatters[subject, cell]
    trials = df[subject, cell]
    bound = np.zeros(scatter.sum())
    steepest = optimize.linprog(trials @ sums, A_ub=-sums[scatter], b_ub=bound, bounds=(-1.0, 1.0))
    moves = sums @ np.asarray(steepest.x)
    # The steepest direction has whole components: one half tells them from zero.
    vanishes = moves < -0.5
    if trials @ moves > -0.5:
        vanishes[:] = False
    return np.unique(cell[vanishes])
