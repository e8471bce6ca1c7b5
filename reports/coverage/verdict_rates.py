"""How often verdicts err.

Classical verdicts are made of simulated studies of known users, with stiffness or damping displayed
well inside, at the edge and well outside of the central range. Bayesian verdicts are made of
studies whose users come from the prior. Both runs go on where they stopped.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import brentq

from percept import Scene, Sessions, Study
from percept.boundary.confidence import Confidence, SubjectPairs, confidence
from percept.boundary.feels_real import search_grid, search_scores
from percept.boundary.users import Users
from percept.checkpoint import Checkpoint, Line
from percept.errors import UsageError
from percept.haptics import Device, Environment, Loop
from percept.haptics.perceived import Display
from percept.inference.classical.central_range import central_range_confidence
from percept.inference.classical.moments import Moments
from percept.inference.model.priors import Priors
from percept.sessions import ReadOptions
from percept.simulate.model import Design, draw_environments, draw_hyperparameters, simulate
from percept.study.verdicts import frequencies
from reports.store import store

Array: TypeAlias = NDArray[np.float64]
#: Confidence that a value so many SDs from the mean of each study's users is in their range.
Rule: TypeAlias = Callable[[Moments, float], Array]

LEVEL, DECISION = 0.99, 0.95
EDGE = float(-special.ndtri(0.5 * (1.0 - LEVEL)))
SIZES = (5, 10, 30)
#: What is displayed, in half-widths of the central range of users: their edge is at one.
PLACES = {"well inside": 0.0, "at the edge": 1.0, "well outside": 2.0}
#: Subjects known to the classical method: logarithms of N/m and N·s/m, independent of each other.
CENTRE = np.log([500.0, 2.0])
SDS = np.array([0.15, 0.3])
DEVICE = Device(mass=0.5, damping=5.0)
PERIOD = 1e-3
#: Studies that are worked on at once.
CHUNK = 1_000
#: Studies of one number of subjects before those of the next.
STEP = 5
#: Standard errors by which a rate may pass what is promised.
CLEAR = 4.0
#: References of the Bayesian studies, N/m and N·s/m.
REFERENCES = np.array([[100.0, 1.0], [500.0, 2.0], [2000.0, 10.0]])


@dataclass
class Rates:
    """Shares of studies with each outcome."""

    studies: int
    real: float
    does_not: float

    @property
    def undecided(self) -> float:
        """Share of studies that say neither."""
        return 1.0 - self.real - self.does_not


def rates_of(outcomes: Sequence[str]) -> Rates:
    """Return shares of outcomes in a list."""
    count = max(1, len(outcomes))
    return Rates(count, outcomes.count("feels real") / count, outcomes.count("does not") / count)


def binomial_error(studies: int) -> float:
    """Return the standard error of a rate of 1 - DECISION."""
    return float(np.sqrt(DECISION * (1.0 - DECISION) / studies))


# Classical verdicts by stiffness and damping.


def by_confidence(users: Moments, score: float) -> Array:
    """Return the confidence that a value `score` SDs from a study's mean is in its users' range."""
    scores = np.full(np.shape(users.mean), score)
    return np.asarray(central_range_confidence(scores, users, central=LEVEL))


def by_wide_limits(users: Moments, score: float) -> Array:
    """Return 1 inside a boundary's limits, 0 outside: they widen with fewer subjects."""
    reach = -special.stdtrit(users.n - 1.0, 0.5 * (1.0 - LEVEL)) * np.sqrt(1.0 + 1.0 / users.n)
    return np.asarray(np.abs(score - users.mean) <= reach * users.sd, dtype=float)


def part_rates(n: int, place: str, studies: int, *, rule: Rule = by_confidence) -> Rates:
    """Return verdicts by both parts: one quantity at a place, the other at the centre."""
    rng = np.random.default_rng([n, round(10 * PLACES[place])])
    outcomes = []
    for start in range(0, studies, CHUNK):
        scores = rng.standard_normal((min(CHUNK, studies - start), n, 2))
        parts = []
        for quantity, score in enumerate((PLACES[place] * EDGE, 0.0)):
            values = scores[:, :, quantity]
            users = Moments(values.mean(axis=1), values.std(axis=1, ddof=1), n)
            parts.append(rule(users, score))
        for stiffness, damping in np.transpose(parts):
            found = Confidence(float(stiffness), float(damping), n)
            outcomes.append(found.verdict(DECISION))
    return rates_of(outcomes)


# Classical verdicts by abs(Z_h).


def display_of(score: float) -> Display:
    """Display a stiffness `score` SDs above the users' mean, and their typical damping."""
    stiffness = float(np.exp(CENTRE[0] + SDS[0] * score))
    environment = Environment(stiffness, float(np.exp(CENTRE[1])))
    return Display(Loop(DEVICE, PERIOD), environment)


def searched(display: Display) -> Array:
    """Return the frequencies that are searched for the smallest margin."""
    resonance = float(np.sqrt(display.environment.stiffness / DEVICE.mass))
    return search_grid(0.1, 100.0, np.array([resonance]), np.array([0.5 * SDS[0]]))


@functools.cache
def edge_score() -> float:
    """Return SDs of stiffness at which the smallest margin of abs(Z_h) over the range is zero."""
    users = Users(True, CENTRE[:, None], SDS[:, None], np.zeros(1))

    def margin(score: float) -> float:
        display = display_of(score)
        found = search_scores(display, users, searched(display), LEVEL)
        return EDGE - float(found.largest[0])

    return float(brentq(margin, 0.5 * EDGE, 1.5 * EDGE))


def magnitude_study(n: int, place: str, index: int) -> Line:
    """Return one study's verdicts: by abs(Z_h) alone, and by all parts."""
    rng = np.random.default_rng([n, round(10 * PLACES[place]), index])
    values = CENTRE + SDS * rng.standard_normal((n, 2))
    display = display_of(PLACES[place] * edge_score())
    pairs = SubjectPairs(values, log=True)
    found = confidence(display, pairs, searched(display), central=LEVEL, decision=DECISION, rng=rng)
    assert found.magnitude is not None
    alone = Confidence(found.magnitude, found.magnitude, n)
    return {"magnitude": alone.verdict(DECISION), "all": found.verdict(DECISION)}


# Bayesian verdicts.


def bayesian_study(n: int, index: int) -> Line:
    """Judge a study of n users of the prior: by environment the truth, the verdict, the old rule.

    None where values leave the range of files, or the gate lets no fit pass.
    """
    rng = np.random.default_rng([n, index])
    design = Design.balanced(REFERENCES, subjects=n)
    values = draw_environments(draw_hyperparameters(design, Priors(), rng), design, rng)
    scene = Scene(
        device={"mass": DEVICE.mass, "damping": DEVICE.damping, "period": PERIOD},
        inference={"method": "bayesian", "kinds": ["user"], "tolerance": 0.1, "seed": index},
    )
    table = simulate(values, design, rng).drop(columns="source")
    units = {"k": "N/m", "b": "N·s/m"}
    names = [(f"{name}_{side}", unit) for name, unit in units.items() for side in ("ref", "adj")]
    columns = {name: {"name": name, "unit": unit} for name, unit in names}
    options = ReadOptions(quantities=scene.quantities, columns=columns)
    try:
        study = Study(Sessions.from_frame(table, scene=options), scene)
    except UsageError:
        # The prior reaches beyond what any file may hold, 1e-100 to 1e100.
        return {"verdicts": []}
    covariances = values.cov_u + values.cov_w
    lines = []
    for verdict in study.verdicts:
        j = design.environments.index(verdict.environment)
        mean = np.log(REFERENCES[j]) + values.beta[j]
        users = Users.of(mean[None], covariances[j][None], log=True)
        lines.append(
            {
                "inside": truly_inside(study, verdict.environment, users),
                "outcome": verdict.outcome,
                "probability": verdict.probability,
                "old": old_rule(study, verdict.environment),
            }
        )
    return {"verdicts": lines}


def truly_inside(study: Study, environment: str, users: Users) -> bool:
    """Say whether an environment lies in the central range of known users at every omega."""
    display = study.setup.display(environment, coupled=False)
    omega = frequencies(study.setup, environment, float(users.sd[0, 0]), study.data.within)
    shown = np.log([display.environment.stiffness, display.environment.damping])
    in_plane = np.all(np.abs(shown - users.mean[:, 0]) <= EDGE * users.sd[:, 0])
    return bool(in_plane and search_scores(display, users, omega, LEVEL).largest[0] <= EDGE)


def old_rule(study: Study, environment: str) -> str:
    """Return what the next user's limits say, which widen with fewer subjects."""
    rows = study.intervals
    rows = rows[(rows["environment"] == environment) & (rows["joint"] == "marginal")]
    inside = (rows["lower"] <= rows["reference"]) & (rows["reference"] <= rows["upper"])
    return "feels real" if inside.all() else "does not"


@dataclass
class Errors:
    """What became of verdicts on users of the prior."""

    studies: int
    verdicts: int
    said_real: int
    outside: int  # Of those said to feel real
    said_not: int
    inside: int  # Of those said not to
    undecided: float  # Share of verdicts

    def within_promise(self) -> bool:
        """Say whether both error rates are at most 1 - DECISION, within binomial error."""
        return all(
            wrong <= (1.0 - DECISION) * said + CLEAR * np.sqrt(DECISION * (1.0 - DECISION) * said)
            for wrong, said in ((self.outside, self.said_real), (self.inside, self.said_not))
        )


def errors_of(lines: Sequence[Line], *, rule: str = "outcome") -> Errors:
    """Count the verdicts of studies by "outcome" or by the "old" rule."""
    verdicts = [verdict for line in lines for verdict in line["verdicts"]]
    real = [verdict["inside"] for verdict in verdicts if verdict[rule] == "feels real"]
    does_not = [verdict["inside"] for verdict in verdicts if verdict[rule] == "does not"]
    return Errors(
        studies=len(lines),
        verdicts=len(verdicts),
        said_real=len(real),
        outside=real.count(False),
        said_not=len(does_not),
        inside=does_not.count(True),
        undecided=1.0 - (len(real) + len(does_not)) / max(1, len(verdicts)),
    )


# The page.

HEAD = """# Errors of verdicts

Verdicts are held against the central {central:g} of users, with decision {decision:g}. A verdict
errs where it says that a display feels real that lies outside the central range of users, or that
one does not that lies inside. Each may happen in at most {wrong:g} of studies.

"""
PARTS = """## Classical: stiffness and damping

{studies:,} studies per row, whose users are known. One quantity is displayed at a place, the other
at the middle. `wide limits` is a rule that fails: it says "feels real" where the next
user's interval holds the display, and that interval widens with fewer subjects.

| displayed | n | said real | said does not | too little data | said real by wide limits |
|---|---|---|---|---|---|
"""
MAGNITUDE = """
## Classical: abs(Z_h)

Stiffness is displayed at the middle, where abs(Z_h) reaches the edge of its range, and at twice
that distance. This part has no exact rate. The last columns are verdicts by all three parts.

| displayed | n | studies | said real | said does not | real by all | does not by all |
|---|---|---|---|---|---|---|
"""
BAYESIAN = """
## Bayesian: users of the prior

Studies of three references whose users come from the prior, {wanted} wanted per row. A rate is that
of errors among the verdicts which say so, ± its binomial error where it is {wrong:g} in truth.
The last column is "real, but outside" of the rule that fails.

| n | studies | verdicts | real, but outside | ± | does not, but inside | ± | undecided |\
 by wide limits |
|---|---|---|---|---|---|---|---|---|
"""


def percent(rate: float) -> str:
    """Write a rate."""
    return f"{100.0 * rate:.2f} %"


def share(wrong: int, said: int) -> str:
    """Write how many of the verdicts that say something are wrong."""
    return f"{wrong} of {said}" + (f" ({percent(wrong / said)})" if said else "")


def of_one(said: int) -> str:
    """Write the binomial error of so many verdicts."""
    return percent(binomial_error(said)) if said else ""


def part_rows(studies: int) -> Iterator[list[object]]:
    """Return the rows by stiffness and damping."""
    for place in PLACES:
        for n in SIZES:
            found = part_rates(n, place, studies)
            old = part_rates(n, place, studies, rule=by_wide_limits)
            rates = (found.real, found.does_not, found.undecided, old.real)
            yield [place, n, *map(percent, rates)]


def magnitude_rows(kept: Mapping[tuple[str, int], Sequence[Line]]) -> Iterator[list[object]]:
    """Return the rows by abs(Z_h)."""
    for (place, n), lines in kept.items():
        alone = rates_of([line["magnitude"] for line in lines])
        together = rates_of([line["all"] for line in lines])
        rates = (alone.real, alone.does_not, together.real, together.does_not)
        yield [place, n, len(lines), *map(percent, rates)]


def bayesian_rows(kept: Mapping[int, Sequence[Line]]) -> Iterator[list[object]]:
    """Return the Bayesian rows."""
    for n, lines in kept.items():
        found = errors_of(lines)
        old = errors_of(lines, rule="old")
        yield [
            n,
            found.studies,
            found.verdicts,
            share(found.outside, found.said_real),
            of_one(found.said_real),
            share(found.inside, found.said_not),
            of_one(found.said_not),
            percent(found.undecided),
            share(old.outside, old.said_real),
        ]


def markdown(rows: Iterable[Sequence[object]]) -> str:
    """Write rows of a table."""
    return "".join("| " + " | ".join(map(str, row)) + " |\n" for row in rows)


def kept_fits(n: int, folder: Path) -> Checkpoint:
    """Return the Bayesian studies of n subjects that a folder keeps."""
    return store(folder, f"{n} subjects")


def page(out: Path, *, studies: int, magnitude: int, fits: int) -> str:
    """Simulate what is missing, and write the page.

    Parameters
    ----------
    out : Path
        Folder that keeps what is done.
    studies : int
        Of each row by stiffness and damping.
    magnitude, fits : int
        Studies by abs(Z_h), and Bayesian ones, of each number of subjects.
    """
    done = {}
    # A few of each in turn: a run that is stopped has as many of each.
    for wanted in range(STEP, fits + STEP, STEP):
        for n in SIZES:
            study = functools.partial(bayesian_study, n)
            done[n] = kept_fits(n, out).complete(study, min(wanted, fits))
    by_magnitude = {}
    for place, n in itertools.product(PLACES, SIZES):
        judged = functools.partial(magnitude_study, n, place)
        by_magnitude[place, n] = store(out, f"{place} {n}").complete(judged, magnitude)
    stated = {"central": LEVEL, "decision": DECISION, "wrong": 1.0 - DECISION}
    parts = [
        HEAD.format(**stated),
        PARTS.format(studies=studies),
        markdown(part_rows(studies)),
        MAGNITUDE,
        markdown(magnitude_rows(by_magnitude)),
        BAYESIAN.format(wanted=fits, **stated),
        markdown(bayesian_rows(done)),
    ]
    return "".join(parts)
