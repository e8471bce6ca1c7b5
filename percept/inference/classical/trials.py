"""From trials to one value per subject: n is subjects, never trials."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from percept.errors import UsageError
from percept.inference.classical.checks import finite_values, positive_values
from percept.inference.classical.claims import Parametric, parametric_family
from percept.inference.classical.exact import MomentsAccumulator
from percept.inference.classical.moments import Moments
from percept.notebook import NotebookRecord


@dataclass(frozen=True, eq=False)
class SubjectMeans(NotebookRecord):
    """One value per subject.

    Parameters
    ----------
    values : ndarray
        Shape (n,): mean of each subject's trials, geometric under ``"lognormal"``; unit of the trials.
    trials : ndarray of int
        Shape (n,): trials behind each.
    subjects : tuple
        Labels in the same order, that of their first trial.
    family : {"normal", "lognormal"}
        On which scale the trials were averaged.
    trial_sd : float, optional
        SD between trials of a subject, pooled, on the family's scale; None without repeats.
    """

    values: NDArray[np.float64]
    trials: NDArray[np.int64]
    subjects: tuple[object, ...]
    family: Parametric
    trial_sd: float | None

    @property
    def rule(self) -> str:
        """How trials became values, as a sentence."""
        kind = "mean" if self.family == "normal" else "geometric mean"
        few, many = int(self.trials.min()), int(self.trials.max())
        if many == 1:
            return "One trial per subject."
        count = f"{many}" if few == many else f"{few} to {many}"
        return f"Each subject counts once, by the {kind} of their {count} trials."

    def moments(self, *, weights: Literal["equal", "trials"] | ArrayLike = "equal") -> Moments:
        """Return what the intervals need.

        Parameters
        ----------
        weights : {"equal", "trials"} or array_like
            ``"equal"``: each subject counts once. ``"trials"`` or one weight per subject: the weighted
            mean of `Moments.from_weighted`, fit for kind ``"mean"`` only.

        Returns
        -------
        Moments
            On the family's scale, marked with whether there are repeats.

        Raises
        ------
        UsageError
            Unknown or unfit weights.
        RefusalError
            Fewer than 2 subjects.
        """
        log, repeats = self.family == "lognormal", self.trial_sd is not None
        if isinstance(weights, str):
            if weights == "equal":
                return Moments.from_values(self.values, log=log, repeats=repeats)
            if weights != "trials":
                raise UsageError(
                    'weights must be "equal", "trials" or one number per subject.', value=weights
                )
            weights = self.trials
        return Moments.from_weighted(self.values, weights, log=log, repeats=repeats)


def subject_means(values: ArrayLike, subjects: ArrayLike, *, family: Parametric = "normal") -> SubjectMeans:
    """Average the trials of each subject, however many each did.

    Parameters
    ----------
    values : array_like
        Shape (trials,), any unit.
    subjects : array_like
        Shape (trials,): who did each.
    family : {"normal", "lognormal"}
        Average the values, or their logarithms.

    Returns
    -------
    SubjectMeans
        In the order in which subjects first appear.

    Raises
    ------
    UsageError
        Shapes that differ, a trial without a subject, unfit values, an unknown family.
    RefusalError
        Zero or negative values under ``"lognormal"``.
    """
    log = parametric_family(family) == "lognormal"
    y = positive_values(values) if log else finite_values(values)
    who = np.asarray(subjects)
    if y.ndim != 1 or who.shape != y.shape:
        raise UsageError(f"One subject per trial is needed; the shapes are {y.shape} and {who.shape}.")
    # What is not equal to itself: NaN, which would otherwise count as one subject.
    if any(label is None or label != label for label in who.tolist()):
        raise UsageError("every trial needs a subject; some have none.", hint="Leave those trials out.")
    if log:
        y = np.log(y)
    labels, first, member, trials = np.unique(who, return_index=True, return_inverse=True, return_counts=True)
    groups = np.split(y[np.argsort(member, kind="stable")], np.cumsum(trials)[:-1])
    means, scatter = np.array([_mean_and_scatter(group) for group in groups]).T
    appearance = np.argsort(first)
    means = means[appearance]
    freedom = y.size - len(groups)
    return SubjectMeans(
        values=np.exp(means) if log else means,
        trials=trials[appearance],
        subjects=tuple(labels[appearance].tolist()),
        family=family,
        trial_sd=math.sqrt(math.fsum(scatter) / freedom) if freedom else None,
    )


def _mean_and_scatter(group: NDArray[np.float64]) -> tuple[float, float]:
    sums = MomentsAccumulator()
    sums.update(group)
    return sums.mean, sums.sd**2 * (sums.n - 1) if sums.n > 1 else 0.0
