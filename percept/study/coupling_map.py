"""How probably other couplings feel real, and are stable in time.

The map is over stiffness and damping, for each environment up to the edge of what is stable with
it. Where the device has a posterior, the edge is that of its most stable draw. The ends of a map
are the stiffest and the softest coupling that feel real with the scene's `decision`. They are found
on it and confirmed by `percept.boundary.feels_real`, which also searches between frequencies.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from percept.boundary.couplings import CouplingJudge
from percept.boundary.feels_real import Evidence, feels_real, share_error
from percept.boundary.shares import Users
from percept.haptics import Coupling, Environment, TabulatedDevice
from percept.haptics.rendering import can_render
from percept.results import AdmissibleCouplings, ConfirmedCoupling, EnvironmentCouplings, Skipped
from percept.scene import Scene
from percept.study.basics import Array
from percept.study.device import Setup, map_frequencies, stiffness_span
from percept.study.stable_couplings import StableCouplings
from percept.study.verdicts import MapUsers, frequencies, relative_sd

#: Draws of the users behind a map of couplings: 0.95 is known to 0.014 by them.
_MAP_DRAWS = 256
#: Where these decide nothing, so many.
_MORE_DRAWS = 1024
#: Draws that confirm an end: on a line of equal probability no number of draws is ever clear of it.
_END_DRAWS = 2048
#: Standard errors between a probability and the decision.
_ERRORS = 2.0
#: Lines of damping of a map, and stiffnesses on each.
_LINES = 33
_STIFFNESSES = 41
#: The last line is a hair's breadth below the largest stable damping, where nothing is left.
_LAST_LINE = 0.98
#: A coupling at the edge of what is stable is pulled inside by this fraction of its stiffness.
_INSIDE = 1e-4
#: Nearer to an edge a coupling stands at it.
_INSIDE_MAP = 1.0 - 2.0 * _INSIDE
#: The softest coupling of a map, against the softest stiffness in users' ranges.
_SOFTER = 0.5
#: A line of a map spans this factor of stiffness at least, also where little is stable.
_LEAST_SPAN = 10.0
#: An end is searched again about the best line so often, on so many lines between its neighbours.
_REFINEMENTS = 2
_LINES_BETWEEN = 9
#: Halvings of the step of a map that holds an end: the stiffness is known to a ten-thousandth.
_HALVINGS = 10
#: Ends that are tried before a search gives up.
_TRIALS = 5

End = Literal["stiffest", "softest"]


def no_coupling_map(setup: Setup, whose: MapUsers) -> Skipped | None:
    """Say why there is no map of couplings; None where there is one."""
    what = "admissible couplings"
    if not whose.draws:
        return Skipped(what, "they need a joint law of stiffness and damping")
    if isinstance(setup.loop.device, TabulatedDevice):
        # Of nothing to render only the table can leave something open.
        unknown = can_render(setup.loop, Environment(0.0, 0.0))
        if unknown.verdict == "undecided":
            return Skipped(what, unknown.reason)
    velocity_filter = setup.loop.velocity_filter
    if velocity_filter is not None and velocity_filter.order > 1:
        why = "from order 2 of the velocity filter on stiffness has a lower limit too"
        return Skipped(what, why)
    if not StableCouplings.of(setup, list(whose.draws)).largest_damping():
        return Skipped(what, "no coupling is stable in time with this device")
    return None


def coupling_map(setup: Setup, whose: MapUsers, scene: Scene) -> AdmissibleCouplings | None:
    """Map the probability that stable couplings feel real, per environment and for all together.

    None where `no_coupling_map` says why. "All together" has the smallest probability.
    """
    if no_coupling_map(setup, whose) is not None:
        return None
    judges = []
    for environment, population in whose.draws.items():
        judges.append(_Environment.of(setup, environment, population, scene))
    maps = [_map_of(judge.name, [judge]) for judge in judges]
    if len(judges) > 1:
        maps.append(_map_of(None, judges))
    return AdmissibleCouplings(
        method=whose.method,
        family=scene.inference.family,
        central=scene.verdict.central,
        decision=scene.inference.decision,
        environments=tuple(maps),
        devices=None if setup.draws is None else setup.draws.count,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Environment:
    """One environment with all that judges its couplings."""

    name: str
    setup: Setup
    judge: CouplingJudge
    users: Users
    draws: int  # Of the users, behind `judge`
    omega: Array  # rad/s, of a map
    searched: Array  # rad/s, where `feels_real` looks first
    scene: Scene
    softest: float  # N/m: a softer coupling is too soft under every draw

    @classmethod
    def of(
        cls,
        setup: Setup,
        name: str,
        users: Users,
        scene: Scene,
    ) -> _Environment:
        """Prepare an environment."""
        within = scene.frequency.lower, scene.frequency.upper
        some = users.select(slice(0, _MAP_DRAWS))
        central = scene.verdict.central
        span = stiffness_span(setup, name, some, central)
        omega = map_frequencies(setup, name, span, within)
        judge = CouplingJudge(setup.display(name, coupled=True), some, omega, central=central)
        searched = frequencies(setup, name, relative_sd(users), within)
        softest = _SOFTER * span.low
        return cls(name, setup, judge, users, some.size, omega, searched, scene, softest)

    def with_more_draws(self) -> _Environment:
        """Judge by more of the users' draws."""
        some = self.users.select(slice(0, _MORE_DRAWS))
        display = self.setup.display(self.name, coupled=True)
        judge = CouplingJudge(display, some, self.omega, central=self.scene.verdict.central)
        return dataclasses.replace(self, judge=judge, draws=some.size)

    def confirm(self, coupling: Coupling) -> Evidence:
        """Judge one coupling by `feels_real`."""
        setup = dataclasses.replace(self.setup, coupling=coupling)
        display = setup.display(self.name, coupled=True)
        some = self.users.select(slice(0, _END_DRAWS))
        central = self.scene.verdict.central
        decision = self.scene.inference.decision
        return feels_real(display, some, self.searched, central=central, decision=decision)


class _Grid(NamedTuple):
    """Couplings on B lines of damping, N·s/m, K stiffnesses each, N/m."""

    damping: Array  # (B,)
    stiffness: Array  # (B, K), increasing to the stable limit


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    """Environments that a coupling has to serve together."""

    environments: Sequence[_Environment]
    stable: StableCouplings

    @property
    def decision(self) -> float:
        """Probability that a coupling has to reach."""
        return self.environments[0].scene.inference.decision

    @property
    def draws(self) -> int:
        """Of the users, behind probabilities."""
        return min(environment.draws for environment in self.environments)

    def lines(self) -> Array:
        """Return dampings from 0 to the largest that is stable, dense at both ends."""
        angle = np.linspace(0.0, _LAST_LINE * 0.5 * np.pi, _LINES)
        return self.stable.largest_damping() * np.sin(angle) ** 2

    def grid(self, damping: Array) -> _Grid:
        """Return couplings up to the stable limit, from one too soft for every environment on."""
        softest = max(environment.softest for environment in self.environments)
        limit = (1.0 - _INSIDE) * np.maximum(self.stable.limit(damping), np.finfo(float).tiny)
        low = np.minimum(softest, limit / _LEAST_SPAN)
        return _Grid(damping, np.geomspace(low, limit, _STIFFNESSES).T)

    def probabilities(self, grid: _Grid) -> Array:
        """Return P(stable) times the smallest of the environments' probabilities, (B, K)."""
        stiffness = grid.stiffness.ravel()
        damping = np.repeat(grid.damping, grid.stiffness.shape[1])
        stable = self.stable.probability(stiffness, damping)
        least = np.where(stable > 0.0, 1.0, 0.0)
        for environment in self.environments:
            maybe = np.flatnonzero(least > 0.0)
            if maybe.size:
                couplings = Coupling(stiffness[maybe], damping[maybe])
                found = environment.judge.probabilities(couplings)
                least[maybe] = np.minimum(least[maybe], found)
        return (stable * least).reshape(grid.stiffness.shape)

    def surely_none(self, probability: Array) -> bool:
        """Whether two errors above every probability no coupling reaches the decision."""
        best = float(probability.max(initial=0.0))
        return best + _ERRORS * share_error(best, self.draws) < self.decision


def _map_of(name: str | None, environments: Sequence[_Environment]) -> EnvironmentCouplings:
    """Map one environment, or several together; by more draws where the first do not decide."""
    setup = environments[0].setup
    stable = StableCouplings.of(setup, [environment.name for environment in environments])
    search = _Search(environments, stable)
    grid = search.grid(search.lines())
    while True:
        probability = search.probabilities(grid)
        ends: dict[End, ConfirmedCoupling | None] = {}
        for end in ("stiffest", "softest"):
            ends[end] = _confirmed_end(search, grid, probability, end)
        outcome: Literal["some", "none", "undecided"] = "undecided"
        if ends["stiffest"] is not None and ends["softest"] is not None:
            outcome = "some"
        elif search.surely_none(probability):
            outcome = "none"
        more = [environment.with_more_draws() for environment in environments]
        if outcome != "undecided" or _Search(more, stable).draws == search.draws:
            break
        search = _Search(more, stable)
    return EnvironmentCouplings(
        name=name,
        damping=grid.damping,
        stiffness=grid.stiffness,
        probability=probability,
        limited=bool(stable.limit(np.zeros(1))[0] < _INSIDE_MAP * _rigid(stable)),
        outcome=outcome,
        draws=search.draws,
        stiffest=ends["stiffest"],
        softest=ends["softest"],
    )


def _rigid(stable: StableCouplings) -> float:
    """Return the stiffness from which on a coupling without damping counts as rigid, N/m."""
    return stable.rigid * 2.0 / stable.setup.loop.period


def _confirmed_end(
    search: _Search, grid: _Grid, probability: Array, end: End
) -> ConfirmedCoupling | None:
    """Return the stiffest or the softest coupling that surely reaches the decision, if one does."""
    wanted = search.decision
    for _ in range(_TRIALS):
        coupling = _refined_end(search, grid, probability, wanted, end)
        if coupling is None:
            return None
        confirmed = _confirmed(search, coupling)
        sure = confirmed.probability - _ERRORS * confirmed.error
        if sure >= search.decision:
            return confirmed
        # What lies between the map's frequencies, and its fewer draws, is asked for on top.
        wanted += max(search.decision - sure, 1.0 / _END_DRAWS)
    return None


def _confirmed(search: _Search, coupling: Coupling) -> ConfirmedCoupling:
    """Say how probably a coupling feels real where it is least probable, and what bounds it."""
    found = [environment.confirm(coupling) for environment in search.environments]
    least = min(found, key=lambda evidence: evidence.probability)
    stable = search.stable.chance(coupling)
    bound: Literal["stability", "magnitude", "plane", "map"] = "magnitude"
    limit = float(search.stable.limit(np.atleast_1d(coupling.damping))[0])
    asked = 0.5 * float(coupling.stiffness) * search.stable.setup.loop.period + float(
        coupling.damping
    )
    if asked >= _INSIDE_MAP * search.stable.rigid:
        bound = "map"
    elif coupling.stiffness >= _INSIDE_MAP * limit or stable.probability < least.probability:
        bound = "stability"
    elif least.plane < least.magnitude:
        bound = "plane"
    return ConfirmedCoupling(
        stiffness=float(coupling.stiffness),
        damping=float(coupling.damping),
        probability=stable.probability * least.probability,
        error=float(np.hypot(least.error, stable.error)),
        draws=least.draws,
        bound=bound,
    )


def _refined_end(
    search: _Search, grid: _Grid, probability: Array, wanted: float, end: End
) -> Coupling | None:
    """Return the end of what is as probable as wanted, on the lines of a map and between them."""
    best = None
    for refinement in range(_REFINEMENTS + 1):
        ends = _ends_on_lines(search, grid, probability, wanted, end)
        if not np.isfinite(ends).any():
            break
        line = int(np.nanargmin(ends) if end == "softest" else np.nanargmax(ends))
        best = Coupling(float(ends[line]), float(grid.damping[line]))
        if refinement < _REFINEMENTS:
            neighbours = grid.damping[max(line - 1, 0) : line + 2]
            between = np.linspace(neighbours[0], neighbours[-1], _LINES_BETWEEN)
            between = np.union1d(between, best.damping)  # so that no refined end is worse
            grid = search.grid(between)
            probability = search.probabilities(grid)
    return best


def _ends_on_lines(
    search: _Search, grid: _Grid, probability: Array, wanted: float, end: End
) -> Array:
    """Return the end on each line of what is as probable as wanted, N/m; NaN without one."""
    enough = probability >= wanted
    ends = np.full(grid.damping.size, np.nan)
    (lines,) = np.nonzero(enough.any(axis=1))
    if not lines.size:
        return ends
    last = grid.stiffness.shape[1] - 1
    if end == "stiffest":
        inner = last - enough[lines, ::-1].argmax(axis=1)
        outer = np.minimum(inner + 1, last)
    else:
        inner = enough[lines].argmax(axis=1)
        outer = np.maximum(inner - 1, 0)
    inside = grid.stiffness[lines, inner]
    outside = grid.stiffness[lines, outer]
    for _ in range(_HALVINGS):
        middle = np.sqrt(inside * outside)
        found = search.probabilities(_Grid(grid.damping[lines], middle[:, None]))[:, 0]
        inside = np.where(found >= wanted, middle, inside)
        outside = np.where(found >= wanted, outside, middle)
    ends[lines] = inside
    return ends
