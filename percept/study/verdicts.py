"""Whether what is displayed feels real to users, judged by both methods with one definition.

An environment feels real where what is displayed lies in the central range of the population of
users at every omega. The Bayesian method gives the posterior probability of that, the classical
method a confidence part by part; `decision` turns either into one of three outcomes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from percept.boundary import confidence as classical
from percept.boundary.confidence import Confidence, confidence, limits_confidence
from percept.boundary.feels_real import feels_real, judge, search_grid
from percept.boundary.users import Users
from percept.errors import RefusalError
from percept.haptics import TabulatedDevice
from percept.haptics.records import Display
from percept.inference.classical.fiducial import fiducial_draws
from percept.inference.classical.moments import Moments
from percept.inference.hierarchy.product import pooled_parts
from percept.inference.record import Family
from percept.results import (
    Confidences,
    Leaning,
    MoreSubjects,
    Note,
    PosteriorEvidence,
    Verdict,
)
from percept.scene import InferenceTable
from percept.sessions import Sessions
from percept.study.basics import Array, Stream, generator
from percept.study.deciding import more_subjects
from percept.study.device import Setup
from percept.study.device_verdicts import with_device_draws
from percept.study.intervals import Cell
from percept.study.regions import SubjectPairs

if TYPE_CHECKING:
    from percept.study.fit import Fit

__all__ = [
    "Subjects", "frequencies", "leaning_on_slips", "likely_users", "posterior_users",
    "relative_sd", "study_verdicts", "subjects_of",
]  # fmt: skip

#: Most draws of the posterior: a probability of 0.95 is known to 0.003 by them.
_MOST_DRAWS = 4096
#: Fiducial draws of a map, where there is no posterior.
_FIDUCIAL_DRAWS = 512
#: Truths that more subjects are simulated of: a probability of 0.8 is known to 0.025 by them.
_TRUTHS = 256
#: Half of a resonance's width against the SD of log k between users, and its least.
_HALF_SD = 0.5
_LEAST_HALF_WIDTH = 1e-3
#: Beyond this logarithm of N/m or N·s/m no impedance of interest changes.
_LARGEST_LOG = 90.0
#: A mean of zero counts as this when an SD is put in proportion to it.
_LEAST_MEAN = 1e-300
_NAMES = ("k", "b")


@dataclasses.dataclass(frozen=True, eq=False)
class Subjects:
    """What the classical method knows of the users of one environment."""

    family: Family
    stiffness: Moments  # On the family's scale
    damping: Moments
    # None with fewer than three subjects, and for published limits.
    pairs: classical.SubjectPairs | None
    trial_variance: Array  # (2,) What trial noise adds to the variance of a subject's value

    def confidence(
        self, setup: Setup, environment: str, asked: InferenceTable, omega: Array, *, coupled: bool
    ) -> Confidence | None:
        """Judge what is displayed; None where subjects do not scatter."""
        display = setup.display(environment, coupled=coupled)
        rng = generator(asked.seed, Stream.FIDUCIAL)
        level = asked.level
        if self.pairs is not None:
            try:
                return confidence(
                    display, self.pairs, omega, level=level, decision=asked.decision, rng=rng
                )
            except RefusalError:
                # Stiffness and damping in proportion have no joint law; each still has its own.
                pass
        try:
            moments = self.stiffness, self.damping
            log = self.family == "lognormal"
            return limits_confidence(display, *moments, omega, level=level, log=log)
        except RefusalError:
            return None


def subjects_of(
    cells: Mapping[Family, Sequence[Cell]], pairs: Sequence[SubjectPairs], asked: InferenceTable
) -> dict[str, Subjects]:
    """Return what the classical method knows, by environment: in the scene's family if it can."""
    found: dict[str, Subjects] = {}
    for family in ("normal", "lognormal", asked.family):
        moments = {
            (cell.parameter, cell.environment): cell.moments.on_scale(family)
            for cell in cells.get(family, ())
            if cell.moments is not None
        }
        values = {pair.environment: pair for pair in pairs if pair.family == family}
        for environment in dict.fromkeys(name for _, name in moments):
            own = [moments.get((parameter, environment)) for parameter in _NAMES]
            stiffness, damping = own
            if stiffness is None or damping is None:
                continue
            of_subjects = values.get(environment)
            pair = _subject_pairs(of_subjects)
            trial_variance = np.zeros(2) if of_subjects is None else of_subjects.trial_variance
            # The family set last stays.
            found[environment] = Subjects(family, stiffness, damping, pair, trial_variance)
    return found


def _subject_pairs(pairs: SubjectPairs | None) -> classical.SubjectPairs | None:
    if pairs is None:
        return None
    values = np.column_stack([pairs.k, pairs.b])
    log = pairs.family == "lognormal"
    return classical.SubjectPairs(np.log(values) if log else values, log)


def posterior_users(fit: Fit, asked: InferenceTable) -> dict[str, Users]:
    """Draw the population of users of each environment, in random order.

    Models that have no joint law of stiffness and damping let them vary independently.
    """
    rng = generator(asked.seed, Stream.USERS)
    points = rng.permutation(fit.points)[:_MOST_DRAWS]
    parts = pooled_parts(fit.model, points)
    draw = _joint_draws if len(parts) == 1 else _separate_draws
    users = {}
    for environment, mean, covariance in draw(fit, points, rng):
        cells = [fit.column[name, environment] for name in _NAMES]
        origin = fit.scale.origin[cells]
        unit = fit.scale.unit[cells]
        centre = np.log(origin) if fit.scale.log else origin
        population = np.multiply.outer(unit, unit) * covariance
        users[environment] = users_in_range(centre + unit * mean, population, log=fit.scale.log)
    return users


def users_in_range(mean: Array, covariance: Array, *, log: bool) -> Users:
    """Return populations; means and SDs beyond the range of impedances move to its end."""
    users = Users.of(mean, covariance, log=log)
    if not log:
        return users
    centre = np.clip(users.mean, -_LARGEST_LOG, _LARGEST_LOG)
    return dataclasses.replace(users, mean=centre, sd=np.minimum(users.sd, _LARGEST_LOG))


def _joint_draws(
    fit: Fit, points: Array, rng: np.random.Generator
) -> Iterator[tuple[str, Array, Array]]:
    """Yield environment, mean (S, 2) and covariance (S, 2, 2) between users, as responses."""
    ((density, coordinates),) = pooled_parts(fit.model, points)
    laws = density.pairs(coordinates)
    for j, environment in enumerate(fit.environments):
        noise = rng.standard_normal((len(points), 2, 1))
        values, vectors = np.linalg.eigh(laws.location[:, j])
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        mean = laws.mean[:, j] + (root @ noise)[..., 0]
        yield environment, mean, laws.users[:, j]


def _separate_draws(
    fit: Fit, points: Array, rng: np.random.Generator
) -> Iterator[tuple[str, Array, Array]]:
    means, _ = fit.model.draw(points, rng)
    variances = fit.model.laws(points).population_sd ** 2
    for environment in fit.environments:
        cells = [fit.column[name, environment] for name in _NAMES]
        yield environment, means[:, cells], variances[:, cells][:, :, None] * np.eye(2)


def fiducial_users(subjects: Subjects, asked: InferenceTable) -> Users | None:
    """Draw populations that the subjects leave likely; None where there is no joint law."""
    if subjects.pairs is None:
        return None
    rng = generator(asked.seed, Stream.FIDUCIAL)
    try:
        draws = fiducial_draws(subjects.pairs.values, _FIDUCIAL_DRAWS, rng)
    except RefusalError:
        return None
    return users_in_range(draws.mean, draws.covariance, log=subjects.pairs.log)


def likely_users(
    subjects: Mapping[str, Subjects], setup: Setup, asked: InferenceTable
) -> dict[str, Users]:
    """Draw the populations of every environment whose subjects have a joint law."""
    likely = {}
    for environment in setup.references:
        known = subjects.get(environment)
        users = fiducial_users(known, asked) if known else None
        if users is not None:
            likely[environment] = users
    return likely


def frequencies(
    setup: Setup, environment: str, relative_sd: float, within: tuple[float, float]
) -> Array:
    """Return the frequencies, rad/s, at which an environment is judged before dips are searched."""
    resonances = setup.resonances(environment)
    resonances = resonances[np.isfinite(resonances) & (resonances > 0.0)]
    half_width = max(_HALF_SD * relative_sd, _LEAST_HALF_WIDTH)
    if isinstance(setup.device, TabulatedDevice):
        # A table's rows are all there is to see.
        half_width = 0.0
    return search_grid(*within, resonances, np.full(resonances.size, min(half_width, 1.0)))


def relative_sd(users: Users) -> float:
    """Return the typical SD of stiffness between users, relative to its mean."""
    sd = float(np.median(users.sd[0]))
    return sd if users.log else sd / max(abs(float(np.median(users.mean[0]))), _LEAST_MEAN)


def study_verdicts(
    setup: Setup,
    users: Mapping[str, Users],
    subjects: Mapping[str, Subjects],
    asked: InferenceTable,
    within: tuple[float, float],
    *,
    stable: bool | None,
) -> Iterator[Verdict]:
    """Judge every reference, directly and through the coupling, at every ω of a range, rad/s.

    `stable` is the coupling's verdict, None where it is undecided.
    """
    renderings = [False]
    if setup.coupling is not None:
        renderings.append(True)
    for environment in setup.references:
        own_users = users.get(environment)
        own_subjects = subjects.get(environment)
        spread = _stiffness_spread(own_users, own_subjects)
        if spread is None:
            continue
        omega = frequencies(setup, environment, spread, within)
        for coupled in renderings:
            evidence = None
            if own_users is not None:
                evidence = _posterior_evidence(
                    setup, environment, own_users, asked, omega, coupled=coupled
                )
            parts = None
            if own_subjects is not None:
                found = own_subjects.confidence(setup, environment, asked, omega, coupled=coupled)
                parts = _confidences(found, own_subjects.family, asked)
            verdict = _verdict(environment, evidence, parts, asked, coupled=coupled, stable=stable)
            if verdict is None:
                continue
            if own_users is not None:
                verdict = with_device_draws(verdict, setup, own_users, omega, asked.decision)
            if _undecided(verdict) and own_subjects is not None:
                display = setup.display(environment, coupled=coupled)
                more = subjects_to_decide(display, own_users, own_subjects, asked, omega)
                verdict = dataclasses.replace(verdict, more=more)
            yield verdict


def _undecided(verdict: Verdict) -> bool:
    """Whether neither method decides: the classical one says how many subjects would."""
    if verdict.classical is None or verdict.classical.outcome != "too little data":
        return False
    return verdict.outcome == "too little data"


def subjects_to_decide(
    display: Display,
    users: Users | None,
    subjects: Subjects,
    asked: InferenceTable,
    omega: Array,
) -> MoreSubjects | None:
    """Find how many more subjects would decide; None without a joint law of subjects."""
    pairs = subjects.pairs
    if pairs is None:
        return None
    if users is None or users.log != pairs.log:
        truths = fiducial_users(subjects, asked)
    else:
        truths = _with_trial_noise(users, subjects.trial_variance)
    if truths is None:
        return None
    return more_subjects(
        display,
        pairs,
        truths.select(slice(_TRUTHS)),
        omega,
        level=asked.level,
        decision=asked.decision,
        rng=generator(asked.seed, Stream.MORE_SUBJECTS),
    )


def _with_trial_noise(users: Users, variance: Array) -> Users:
    """Return populations of what users set on average over their trials."""
    sd = np.sqrt(users.sd**2 + variance[:, None])
    correlation = users.correlation * (users.sd / sd).prod(axis=0)
    return dataclasses.replace(users, sd=sd, correlation=correlation)


def leaning_on_slips(
    verdicts: Iterable[Verdict],
    sessions: Sessions,
    verdicts_over: Callable[[Sessions], Sequence[Verdict]],
) -> Iterator[Verdict]:
    """Add what verdicts become without the rows that look mistyped.

    `verdicts_over` judges other sessions of the same scene.
    """
    doubted = {slip.index for slip in sessions.slips}
    kept = sessions.table.drop(index=list(doubted))
    try:
        others = verdicts_over(dataclasses.replace(sessions, table=kept))
    except RefusalError:
        others = ()
    without = {(verdict.environment, verdict.coupled): verdict for verdict in others}
    for verdict in verdicts:
        rows = []
        for slip in sessions.slips:
            if slip.environment == verdict.environment:
                place = sessions.place(slip.index)
                file = PurePath(place.get("file", "")).name
                rows.append(Note(slip.text, file, place.get("row")))
        leaning = None
        if rows:
            other = without.get((verdict.environment, verdict.coupled))
            leaning = Leaning(rows=tuple(rows), without=other)
        yield dataclasses.replace(verdict, leaning=leaning)


def _stiffness_spread(users: Users | None, subjects: Subjects | None) -> float | None:
    """Return the SD of stiffness between users, relative to its mean; None of neither."""
    if users is not None:
        return relative_sd(users)
    if subjects is None:
        return None
    moments = subjects.stiffness
    if subjects.family == "lognormal":
        return float(moments.sd)
    return float(moments.sd) / max(abs(float(moments.mean)), _LEAST_MEAN)


def _verdict(
    environment: str,
    evidence: PosteriorEvidence | None,
    parts: Confidences | None,
    asked: InferenceTable,
    *,
    coupled: bool,
    stable: bool | None,
) -> Verdict | None:
    """Put the evidence of both methods together; the Bayesian outcome leads where there is one."""
    together = None
    if evidence is not None:
        outcome = evidence.outcome
        probability = evidence.probability
        if coupled and stable is not None:
            together = evidence.probability if stable else 0.0
    elif parts is not None:
        outcome = parts.outcome
        probability = parts.least
    else:
        return None
    return Verdict(
        environment=environment,
        coupled=coupled,
        level=asked.level,
        decision=asked.decision,
        outcome=outcome,
        method="classical" if evidence is None else "bayesian",
        probability=probability,
        bayesian=evidence,
        classical=parts,
        stable_and_real=together,
    )


def _posterior_evidence(
    setup: Setup,
    environment: str,
    users: Users,
    asked: InferenceTable,
    omega: Array,
    *,
    coupled: bool,
) -> PosteriorEvidence:
    display = setup.display(environment, coupled=coupled)
    found = feels_real(display, users, omega, level=asked.level, decision=asked.decision)
    return PosteriorEvidence(
        outcome=judge(found.probability, asked.decision),
        probability=found.probability,
        error=found.error,
        draws=found.draws,
        straddles=not found.clear_of(asked.decision),
        magnitude=found.magnitude,
        plane=found.plane,
        lowest=found.lowest,
        lowest_omega=found.lowest_omega,
    )


def _confidences(
    found: Confidence | None, family: Family, asked: InferenceTable
) -> Confidences | None:
    if found is None:
        return None
    return Confidences(
        outcome=found.verdict(asked.decision),
        family=family,
        least=min(found.parts),
        stiffness=found.stiffness,
        damping=found.damping,
        magnitude=found.magnitude,
        magnitude_omega=found.magnitude_omega,
        together=found.together,
        together_error=found.together_error,
    )
