"""Whether what is displayed feels real to users, judged by both methods with one definition.

An environment feels real where what is displayed lies in the central range of the population of
users at every omega. The Bayesian method gives the posterior probability of that, the classical
method a confidence part by part; `decision` turns either into one of three outcomes.
"""

from __future__ import annotations

import bisect
import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from percept.boundary.confidence import PARTS, Subjects, confidence, fiducial_users
from percept.boundary.feels_real import CENTRALS, Evidence, feels_real, search_grid
from percept.boundary.shares import LEAST, STIFFNESS, Users, score_of
from percept.errors import RefusalError
from percept.haptics import TabulatedDevice
from percept.haptics.perceived import Display
from percept.inference.record import Family, Method
from percept.results import (
    CentralProbability,
    Leaning,
    MoreSubjects,
    Note,
    PosteriorEvidence,
    Rendered,
    Verdict,
)
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import Array, Stream, generator, known
from percept.study.data import Data
from percept.study.device import Setup
from percept.study.regions import SubjectPairs, pairs_of_fit
from percept.study.rendering import margins_of_draws

if TYPE_CHECKING:
    from percept.study.fit import Fit


#: Columns of `verdict_table`.
_VERDICT_COLUMNS = (
    "environment", "coupled", "method", "rendered", "outcome", "probability", "more",
)  # fmt: skip
#: Half a resonance's relative width per relative SD of k (omega goes with its root), and the least.
_HALF_WIDTH_PER_SD = 0.5
_LEAST_HALF_WIDTH = 1e-3
#: Probability with which the wanted number decides; as in plans of interval widths.
ASSURANCE = 0.8
#: Further subjects beyond which no number is given.
_MOST_MORE = 1_000
#: Distances beyond so many SDs are not told apart: a few subjects decide on all of them.
_FARTHEST = 10.0
_PARAMETERS = ("k", "b")


def subjects_of(data: Data, pairs: Sequence[SubjectPairs]) -> dict[str, Subjects]:
    """Return what the classical method knows, by environment: in the scene's family if it can."""
    values = {(pair.family, pair.environment): np.column_stack([pair.k, pair.b]) for pair in pairs}
    by_environment: dict[str, Subjects] = {}
    families: tuple[Family, ...] = (data.asked.family, "lognormal", "normal")
    for family in families:
        moments = data.moments(family)
        for environment in data.environments:
            stiffness, damping = (moments.get((name, environment)) for name in _PARAMETERS)
            if stiffness is None or damping is None or environment in by_environment:
                continue
            users = None
            of_both = values.get((family, environment))
            if of_both is not None:
                log = family == "lognormal"
                rng = generator(data.asked.seed, Stream.FIDUCIAL)
                users = fiducial_users(np.log(of_both) if log else of_both, log=log, rng=rng)
            by_environment[environment] = Subjects(family, stiffness, damping, users)
    return by_environment


def posterior_users(fit: Fit) -> dict[str, Users]:
    """Draw the population of users of each environment, in random order.

    Models that have no joint law of stiffness and damping let them vary independently.
    """
    rng = generator(fit.data.asked.seed, Stream.USERS)
    # These are `fit.shuffled`; normals follow them in the stream.
    points = rng.permutation(fit.points)[: len(fit.shuffled)]
    users = {}
    for environment, pairs, scale in pairs_of_fit(fit, points, fit.environments):
        normals = rng.standard_normal((len(points), 2, 1))
        values, vectors = np.linalg.eigh(pairs.location[:, 0])
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        mean = scale.centre + scale.unit * (pairs.mean[:, 0] + (root @ normals)[..., 0])
        covariance = np.multiply.outer(scale.unit, scale.unit) * pairs.users[:, 0]
        users[environment] = Users.of(mean, covariance, log=scale.log)
    return users


class MapUsers(NamedTuple):
    """Whose feelings the maps of couplings and of devices show."""

    draws: Mapping[str, Users]  # Of the population, in random order, by environment
    method: Method


def frequencies(setup: Setup, environment: str, relative_sd: float, scene: Scene) -> Array:
    """Return the frequencies, rad/s, at which an environment is judged before peaks are searched.

    Shape (M,), or (D, M) where the device of the setup is D devices.
    """
    half_width = min(max(_HALF_WIDTH_PER_SD * relative_sd, _LEAST_HALF_WIDTH), 1.0)
    if isinstance(setup.loop.device, TabulatedDevice):
        # A table's rows are all there is to see.
        half_width = 0.0
    resonances = setup.resonances(environment)
    return search_grid(scene.frequency.lower, scene.frequency.upper, resonances, half_width)


def relative_sd(users: Users) -> float:
    """Return the typical SD of stiffness between users, relative to its mean."""
    typical = users.typical()
    sd = float(typical.sd[STIFFNESS, 0])
    return sd if users.log else sd / max(abs(float(typical.mean[STIFFNESS, 0])), LEAST)


def evidence_of(
    setup: Setup,
    environment: str,
    users: Users,
    scene: Scene,
    *,
    coupled: bool,
    spread: float | None = None,
    **options: Any,
) -> Evidence:
    """Judge a reference under draws of the users, each on a draw of the device where it has some.

    `spread` is their relative SD of stiffness, if not that of the draws. Options go to
    `feels_real`.
    """
    if setup.draws is not None:
        which = np.arange(users.size) % np.size(setup.draws.mass)
        setup = setup.with_device(setup.draws.select(which))
    return feels_real(
        setup.display(environment, coupled=coupled),
        users,
        frequencies(setup, environment, spread or relative_sd(users), scene),
        central=scene.verdict.central,
        decision=scene.inference.decision,
        **options,
    )


def study_verdicts(
    setup: Setup,
    users: Mapping[str, Users],
    subjects: Mapping[str, Subjects],
    scene: Scene,
    *,
    stable: Mapping[tuple[str | None, bool], bool | None],
    weights: Mapping[str, Array],
) -> Iterator[Verdict]:
    """Judge every reference, directly and through the coupling, at every ω of the scene's range.

    `stable` says by environment, and whether through the coupling, if it can be rendered. `weights`
    are those of the users' draws without each subject, (D, N), where they are known. The Bayesian
    outcome leads where there is one.
    """
    central = scene.verdict.central
    decision = scene.inference.decision
    at_point = dataclasses.replace(setup, draws=None)
    for environment, coupled in setup.displays():
        display = setup.display(environment, coupled=coupled)
        of_users = users.get(environment)
        of_subjects = subjects.get(environment)
        count = 0 if of_subjects is None else int(of_subjects.stiffness.n)
        likely = bayesian = classical = stable_and_real = None
        without_each: list[float] = []
        if of_users is not None:
            likely = evidence_of(setup, environment, of_users, scene, coupled=coupled)
            bayesian = _reported(likely, decision, count)
            is_stable = stable.get((environment, coupled))
            stable_and_real = _stable_and_real(setup, display, likely, stable=is_stable)
            if environment in weights:
                by_draw = weights[environment][: likely.draws]
                # A large study weighs fewer draws than it judges.
                real = likely.real[: len(by_draw)]
                without_each = (real @ by_draw / by_draw.sum(axis=0)).tolist()
        if of_subjects is not None and scene.inference.method != "bayesian":
            fiducial = None
            if of_subjects.users is not None:
                spread = of_subjects.relative_sd if of_users is None else relative_sd(of_users)
                fiducial = evidence_of(
                    at_point, environment, of_subjects.users, scene, coupled=coupled, spread=spread
                )
            likely = likely or fiducial
            # Subjects who do not scatter show nothing.
            with suppress(RefusalError):
                within = scene.frequency.lower, scene.frequency.upper
                classical = confidence(
                    display,
                    of_subjects,
                    within,
                    central=central,
                    decision=decision,
                    likely=fiducial,
                )
        leading = bayesian or classical
        if leading is None:
            continue
        more = None
        outcomes = {row.outcome for row in (bayesian, classical) if row}
        if classical is not None and likely is not None and outcomes == {"too little data"}:
            more = more_subjects(likely.scores, count, central=central, decision=decision)
        yield Verdict(
            environment=environment,
            coupled=coupled,
            central=central,
            decision=decision,
            subjects=count,
            outcome=leading.outcome,
            method="classical" if bayesian is None else "bayesian",
            probability=leading.probability,
            bayesian=bayesian,
            classical=classical,
            stable_and_real=stable_and_real,
            more=more,
            without=tuple(map(known, without_each)),
        )


def _stable_and_real(
    setup: Setup, display: Display, evidence: Evidence, *, stable: bool | None
) -> float | None:
    """Return the probability that a display is stable in time and feels real.

    Of a device that is a posterior's draws by these; else None where stability is undecided.
    """
    if setup.draws is None:
        return None if stable is None else evidence.probability * stable
    margins = margins_of_draws(setup.draws, setup.loop, display.environment, display.coupling)
    # Of devices with modes fewer have a margin than there are draws.
    judged = min(margins.size, evidence.draws)
    stable_and_real = evidence.real[:judged] & (margins[:judged] > 1.0)
    return float(stable_and_real.mean())


def more_subjects(scores: Array, subjects: int, *, central: float, decision: float) -> MoreSubjects:
    """Find how many more subjects would decide whether a display feels real.

    Under a draw of the users what is displayed lies z SDs from the median user, by the part that is
    least favourable. N + n subjects estimate z with the variance v(z) = (1 + z²/2)/(N + n). With e
    the edge of the central range, the classical rule says "feels real" of estimates below
    e - q·√v(e) and "does not" of those above e + q'·√v(e), where q and q' are normal quantiles of
    the confidences that it asks for.

    Parameters
    ----------
    scores : ndarray, shape (D,)
        Under each draw of the users, how many SDs what is displayed lies from the median user.
    subjects : int
        Those that there are, N.
    central : float
        Share of all users that a central range holds.
    decision : float
        Confidence from which a display is said to feel real.

    Returns
    -------
    MoreSubjects
        The smallest number, up to 1,000, that decides with the probability `ASSURANCE`.
    """
    edge = score_of(central)
    scores = np.minimum(scores, _FARTHEST)
    for_real = special.ndtri(decision)
    for_not = -special.ndtri((1.0 - decision) / PARTS)

    def probability(more: int) -> float:
        root_n = np.sqrt(subjects + more)
        at_edge = np.sqrt(1.0 + 0.5 * edge**2) / root_n
        error = np.sqrt(1.0 + 0.5 * scores**2) / root_n
        real = special.ndtr((edge - for_real * at_edge - scores) / error)
        does_not = special.ndtr((scores - edge - for_not * at_edge) / error)
        return float((real + does_not).mean())

    count = 1 + bisect.bisect_left(range(1, _MOST_MORE + 1), ASSURANCE, key=probability)
    wanted = count if count <= _MOST_MORE else None
    return MoreSubjects(subjects=wanted, assurance=ASSURANCE, most=_MOST_MORE)


def _reported(evidence: Evidence, decision: float, subjects: int) -> PosteriorEvidence:
    """Make a record of the Bayesian evidence."""
    by_central = zip(CENTRALS, evidence.by_central, strict=True)
    return PosteriorEvidence(
        outcome=evidence.outcome(decision, subjects),
        probability=evidence.probability,
        error=evidence.error,
        draws=evidence.draws,
        straddles=not evidence.clear_of(decision),
        magnitude=evidence.magnitude,
        plane=evidence.plane,
        by_central=tuple(CentralProbability(*pair) for pair in by_central),
        lowest_omega=evidence.lowest_omega,
    )


def leaning_on_slips(
    verdicts: Iterable[Verdict], sessions: Sessions, without: Iterable[Verdict]
) -> Iterator[Verdict]:
    """Add what verdicts become without the rows that look mistyped; `without` are those."""
    others = {(verdict.environment, verdict.coupled): verdict for verdict in without}
    for verdict in verdicts:
        rows = []
        for slip in sessions.slips:
            if sessions.table["environment"][slip.row] == verdict.environment:
                file, row = sessions.locate(slip.row)
                rows.append(Note(slip.message, PurePath(file or "").name, row))
        leaning = None
        if rows:
            other = others.get((verdict.environment, verdict.coupled))
            leaning = Leaning(rows=tuple(rows), without=other)
        yield dataclasses.replace(verdict, leaning=leaning)


def verdict_table(verdicts: Sequence[Verdict], rendering: Sequence[Rendered]) -> pd.DataFrame:
    """Lay verdicts out: a row per environment, display and method.

    Parameters
    ----------
    verdicts : sequence of Verdict
        By both methods.
    rendering : sequence of Rendered
        Of the same displays.

    Returns
    -------
    DataFrame
        `rendered` is "can", "cannot" or "undecided", of every passive hand. `outcome` says whether
        the display feels real, if it can be rendered. `probability` is that of lying among the
        central share of users, or the classical method's least confidence in it. `more` is the
        number of further subjects that would decide.
    """
    rendered = {(row.environment, row.coupled): row.verdict for row in rendering}
    rows = []
    for verdict in verdicts:
        more = None if verdict.more is None else verdict.more.subjects
        display = (verdict.environment, verdict.coupled)
        can = rendered[display]
        for method, found in (("classical", verdict.classical), ("bayesian", verdict.bayesian)):
            if found is not None:
                outcome = "cannot be rendered" if can == "cannot" else found.outcome
                rows.append((*display, method, can, outcome, found.probability, more))
    table = pd.DataFrame(rows, columns=_VERDICT_COLUMNS)
    return table.astype({"coupled": bool, "probability": float, "more": "Int64"})
