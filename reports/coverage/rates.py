"""How often verdicts err.

Classical verdicts are made of simulated studies of known users, with stiffness or damping displayed
well inside, at the edge and well outside of the central range. Bayesian verdicts are made of
studies whose users come from the prior. Both runs go on where they stopped.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import brentq

from percept import Scene, Sessions, Study
from percept.boundary.confidence import Subjects, confidence, fiducial_users, outcome_of
from percept.boundary.feels_real import feels_real, search_grid, search_scores
from percept.boundary.shares import Users
from percept.checkpoint import Checkpoint, Line
from percept.errors import UsageError
from percept.haptics import Device, Environment, Loop
from percept.haptics.perceived import Display
from percept.inference.classical.fiducial import central_range_confidence
from percept.inference.classical.moments import Moments
from percept.inference.model.priors import Priors
from percept.simulate import Design, draw_environments, draw_hyperparameters, simulate
from reports.page import Page, store

Array = NDArray[np.float64]

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
#: Standard errors by which a rate may pass what is promised.
CLEAR = 4.0
#: References of the Bayesian studies, N/m and N·s/m.
REFERENCES = np.array([[100.0, 1.0], [500.0, 2.0], [2000.0, 10.0]])
# Declared units: subjects of the prior differ so much that units would seem to.
_COLUMNS = Scene(
    columns={
        name: {"name": name, "unit": unit}
        for unit, names in {"N/m": ("k_ref", "k_adj"), "N·s/m": ("b_ref", "b_adj")}.items()
        for name in names
    }
)


def rates_of(outcomes: Sequence[str]) -> tuple[float, float, float]:
    """Return the shares of studies that say "feels real", that it does not, and neither."""
    count = max(1, len(outcomes))
    real = outcomes.count("feels real") / count
    does_not = outcomes.count("does not") / count
    return real, does_not, 1.0 - real - does_not


def binomial_error(studies: int) -> float:
    """Return the standard error of a rate of 1 - DECISION."""
    return float(np.sqrt(DECISION * (1.0 - DECISION) / studies))


def part_rates(n: int, place: str, studies: int) -> tuple[float, float, float]:
    """Return classical verdicts by stiffness and damping: one at a place, the other at the centre.

    Parameters
    ----------
    n : int
        Subjects.
    place : str
        Of `PLACES`.
    studies : int
        How many.

    Returns
    -------
    tuple of float
        As `rates_of` gives them.
    """
    rng = np.random.default_rng([n, round(10 * PLACES[place])])
    outcomes = []
    for start in range(0, studies, CHUNK):
        values = rng.standard_normal((min(CHUNK, studies - start), n, 2))
        users = Moments(values.mean(axis=1), values.std(axis=1, ddof=1), n)
        scores = np.tile([PLACES[place] * EDGE, 0.0], (len(values), 1))
        parts = np.asarray(central_range_confidence(scores, users, central=LEVEL))
        for pair in parts.tolist():
            outcomes.append(outcome_of(*pair, subjects=n, decision=DECISION))
    return rates_of(outcomes)


def display_of(stiffness: float, damping: float) -> Display:
    """Display an environment by the device."""
    return Display(Loop(DEVICE, PERIOD), Environment(stiffness, damping))


def display_at(score: float) -> Display:
    """Display a stiffness `score` SDs above the users' mean, and their typical damping."""
    stiffness, damping = np.exp(CENTRE + SDS * [score, 0.0]).tolist()
    return display_of(stiffness, damping)


def searched(display: Display, sd: float) -> Array:
    """Return the frequencies that are searched for the smallest margin."""
    resonance = float(np.sqrt(display.environment.stiffness / DEVICE.mass))
    return search_grid(0.1, 100.0, np.array([resonance]), 0.5 * sd)


def margin(display: Display, users: Users) -> float:
    """Return the smallest margin of abs(Z_h) over the range, SDs of known users."""
    omega = searched(display, users.sd[0, 0])
    return EDGE - float(search_scores(display, users, omega, np.array([EDGE])).largest[0])


@functools.cache
def edge_score() -> float:
    """Return SDs of stiffness at which the smallest margin of abs(Z_h) over the range is zero."""
    users = Users(True, CENTRE[:, None], SDS[:, None], np.zeros(1))
    return float(brentq(lambda score: margin(display_at(score), users), 0.5 * EDGE, 1.5 * EDGE))


def magnitude_study(n: int, place: str, index: int) -> Line:
    """Return one study's verdicts: by abs(Z_h) alone, and by all parts."""
    rng = np.random.default_rng([n, round(10 * PLACES[place]), index])
    values = CENTRE + SDS * rng.standard_normal((n, 2))
    display = display_at(PLACES[place] * edge_score())
    omega = searched(display, SDS[0])
    users = fiducial_users(values, log=True, rng=rng)
    assert users is not None
    likely = feels_real(display, users, omega, central=LEVEL, decision=DECISION)
    stiffness, damping = map(Moments.from_values, values.T)
    subjects = Subjects("lognormal", stiffness, damping, users)
    found = confidence(
        display, subjects, (0.1, 100.0), central=LEVEL, decision=DECISION, likely=likely
    )
    alone = outcome_of(likely.lowest, 1.0, subjects=n, decision=DECISION)
    return {"magnitude": alone, "all": found.outcome}


def bayesian_study(n: int, index: int) -> Line:
    """Judge a study of n users of the prior: by environment the truth and the verdict.

    Without verdicts where values leave the range of files, or the gate lets no fit pass.
    """
    rng = np.random.default_rng([n, index])
    design = Design.balanced(REFERENCES, subjects=n)
    values = draw_environments(draw_hyperparameters(design, Priors(), rng), design, rng)
    scene = Scene(
        device={"mass": DEVICE.mass, "damping": DEVICE.damping, "period": PERIOD},
        inference={"method": "bayesian", "kinds": ["user"], "tolerance": 0.1, "seed": index},
    )
    table = simulate(values, design, rng).drop(columns="source")
    try:
        study = Study(Sessions.from_frame(table, scene=_COLUMNS), scene)
    except UsageError:
        # The prior reaches beyond what any file may hold, 1e-100 to 1e100.
        return {"verdicts": []}
    covariances = values.cov_users(design.decades)
    lines = []
    for verdict in study.verdict_rows:
        j = design.environments.index(verdict.environment)
        mean = np.log(REFERENCES[j]) + values.beta[j]
        inside = truly_inside(j, Users.of(mean[None], covariances[j][None], log=True))
        lines.append(
            {
                "inside": inside,
                "outcome": verdict.outcome,
                "probability": verdict.probability,
            }
        )
    return {"verdicts": lines}


def truly_inside(environment: int, users: Users) -> bool:
    """Say whether a reference lies in the central range of known users at every omega."""
    shown = REFERENCES[environment]
    in_plane = np.abs(np.log(shown) - users.mean[:, 0]) <= EDGE * users.sd[:, 0]
    return bool(in_plane.all()) and margin(display_of(*shown.tolist()), users) >= 0.0


@dataclass
class Errors:
    """What became of verdicts on users of the prior."""

    studies: int
    verdicts: int
    said_real: int
    outside: int  # Of those said to feel real
    said_not: int
    inside: int  # Of those said not to

    @property
    def undecided(self) -> float:
        """Share of verdicts."""
        return 1.0 - (self.said_real + self.said_not) / max(1, self.verdicts)

    def within_promise(self) -> bool:
        """Say whether both error rates are at most 1 - DECISION, within binomial error."""
        for wrong, said in ((self.outside, self.said_real), (self.inside, self.said_not)):
            error = np.sqrt(DECISION * (1.0 - DECISION) * said)
            if wrong > (1.0 - DECISION) * said + CLEAR * error:
                return False
        return True


def errors_of(lines: Sequence[Line]) -> Errors:
    """Count the verdicts of studies."""
    verdicts = [verdict for line in lines for verdict in line["verdicts"]]
    real = [verdict["inside"] for verdict in verdicts if verdict["outcome"] == "feels real"]
    does_not = [verdict["inside"] for verdict in verdicts if verdict["outcome"] == "does not"]
    wrong = real.count(False), does_not.count(True)
    return Errors(len(lines), len(verdicts), len(real), wrong[0], len(does_not), wrong[1])


def kept_fits(n: int, folder: Path) -> Checkpoint:
    """Return the Bayesian studies of n subjects that a folder keeps."""
    return store(folder, f"{n} subjects")


def percent(rate: float) -> str:
    """Write a rate."""
    return f"{100.0 * rate:.2f} %"


def share(wrong: int, said: int) -> list[str]:
    """Write how many of the verdicts that say something are wrong, and the binomial error."""
    if not said:
        return [f"{wrong} of {said}", ""]
    return [f"{wrong} of {said} ({percent(wrong / said)})", percent(binomial_error(said))]


def page(out: Path, *, studies: int = 20_000, magnitude: int = 400, fits: int = 300) -> Page:
    """Judge simulated studies that are not kept yet, and count what verdicts get wrong.

    Parameters
    ----------
    out : Path
        Folder that keeps what is done.
    studies : int
        Of each row by stiffness and damping.
    magnitude, fits : int
        Studies by abs(Z_h), and Bayesian ones, of each number of subjects.

    Returns
    -------
    Page
    """
    wrong = 1.0 - DECISION
    page = Page(
        "Errors of verdicts",
        f"Verdicts are held against the central {LEVEL:g} of users, with decision {DECISION:g}. A"
        " verdict errs where it says that a display feels real that lies outside the central range"
        " of users, or that one does not that lies inside. Each may happen in at most"
        f" {wrong:.2g} of studies.",
        "## Classical: stiffness and damping",
        f"{studies:,} studies per row, whose users are known. One quantity is displayed at a place,"
        " the other at the middle.",
    )
    rows: list[list[object]] = []
    for place, n in itertools.product(PLACES, SIZES):
        rows.append([place, n, *map(percent, part_rates(n, place, studies))])
    page.table(["displayed", "n", "said real", "said does not", "too little data"], rows)
    page.add("## Classical: abs(Z_h)")
    page.add(
        "Stiffness is displayed at the middle, where abs(Z_h) reaches the edge of its range, and at"
        " twice that distance. This part has no exact rate. The last columns are verdicts by all"
        " three parts."
    )
    rows = []
    for place, n in itertools.product(PLACES, SIZES):
        judged = functools.partial(magnitude_study, n, place)
        lines = store(out, f"{place} {n}").complete(judged, magnitude)
        alone = rates_of([line["magnitude"] for line in lines])
        together = rates_of([line["all"] for line in lines])
        rows.append([place, n, len(lines), *map(percent, alone[:2] + together[:2])])
    heads = ["displayed", "n", "studies", "said real", "said does not"]
    page.table([*heads, "real by all", "does not by all"], rows)
    page.add("## Bayesian: users of the prior")
    page.add(
        f"Studies of three references whose users come from the prior, {fits} wanted per row. A"
        " rate is that of errors among the verdicts which say so, ± its binomial error where it is"
        f" {wrong:.2g} in truth."
    )
    rows = []
    for n in SIZES:
        each = errors_of(kept_fits(n, out).complete(functools.partial(bayesian_study, n), fits))
        real = share(each.outside, each.said_real)
        does_not = share(each.inside, each.said_not)
        rows.append([n, each.studies, each.verdicts, *real, *does_not, percent(each.undecided)])
        page.right &= each.within_promise()
    heads = ["n", "studies", "verdicts", "real, but outside", "±", "does not, but inside", "±"]
    page.table([*heads, "undecided"], rows)
    return page
