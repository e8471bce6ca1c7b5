"""How probably other couplings, and other devices, feel real.

The map of couplings is over stiffness and damping, up to the edge of what is stable with the
device, or with its most stable draw. The stiffest and the softest coupling that feel real are
confirmed by `feels_real`. Mass and damping of a device are seldom known well: every display is
judged again at ± 50 % of either.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from percept.boundary.couplings import CouplingJudge
from percept.boundary.feels_real import Evidence, feels_real, judge, rough_probability
from percept.boundary.users import Users
from percept.haptics import Coupling, Device, TabulatedDevice
from percept.haptics.search import covers_range
from percept.results import (
    AdmissibleCouplings,
    ChangedVerdict,
    ConfirmedCoupling,
    EnvironmentCouplings,
    OtherDevices,
)
from percept.results.fields import Method
from percept.scene import Scene
from percept.study.basics import Array, Skipped
from percept.study.device import Setup, map_frequencies, stiffness_span
from percept.study.stable_couplings import StableCouplings, is_stable
from percept.study.verdicts import frequencies, relative_sd

__all__ = ["coupling_map", "no_coupling_map", "no_other_devices", "other_devices"]

#: Draws of the users behind a map of couplings: 0.95 is known to 0.014 by them.
_MAP_DRAWS = 256
#: Draws that confirm an end: on a line of equal probability no number of draws is ever clear of it.
_END_DRAWS = 512
#: Lines of damping of a map, and stiffnesses on each.
_LINES = 33
_STIFFNESSES = 41
#: The last line is a hair's breadth below the largest stable damping, where nothing is left.
_LAST_LINE = 0.98
#: A coupling at the edge of what is stable is pulled inside by this fraction of its stiffness.
_INSIDE = 1e-4
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

#: Draws of the users behind a probability: it is known to 0.02 by them, and differences better.
_DEVICE_DRAWS = 512
#: Of the scene's mass or damping, which are seldom known better.
_LESS = 0.5
_MORE = 1.5

End = Literal["stiffest", "softest"]


def no_coupling_map(setup: Setup, users: Mapping[str, Users]) -> Skipped | None:
    """Say why there is no map of couplings; None where there is one."""
    device = setup.device
    what = "admissible couplings"
    if isinstance(device, TabulatedDevice) and not covers_range(device, setup.period):
        covered = f"{device.omega[0]:g} to {device.omega[-1]:g} rad/s"
        needed = f"all of 0 to {np.pi / setup.period:g}"
        return Skipped(what, f"the device's table covers {covered}, and stability needs {needed}")
    if not setup.largest_coupling_damping():
        return Skipped(what, setup.why_no_coupling)
    if not users:
        return Skipped(what, "they need a joint law of stiffness and damping")
    return None


def coupling_map(
    setup: Setup,
    users: Mapping[str, Users],
    method: Method,
    scene: Scene,
    within: tuple[float, float],
) -> AdmissibleCouplings | None:
    """Map the probability that stable couplings feel real, per environment and for all together.

    Parameters
    ----------
    setup : Setup
        Device and references.
    users : mapping of str to Users
        Draws of the population, in random order, by environment.
    method : {"bayesian", "classical"}
        Whose draws these are.
    scene : Scene
        With the central share and the decision.
    within : tuple of float
        Ends of the frequencies that couplings are judged over, rad/s.

    Returns
    -------
    AdmissibleCouplings or None
        None where `no_coupling_map` says why. "All together" has the smallest probability.
    """
    if no_coupling_map(setup, users) is not None:
        return None
    stable = StableCouplings.of(setup)
    judges = []
    for environment, population in users.items():
        judges.append(_Environment.of(stable, environment, population, scene, within))
    damping = _lines(stable.largest_damping)
    maps = [_map_of(environment.name, [environment], damping) for environment in judges]
    if len(judges) > 1:
        maps.append(_map_of(None, judges, damping))
    return AdmissibleCouplings(
        method=method,
        family=scene.inference.family,
        central=scene.verdict.central,
        decision=scene.inference.decision,
        draws=min(_MAP_DRAWS, *(population.size for population in users.values())),
        damping=damping,
        environments=tuple(maps),
        devices=stable.devices,
    )


def _lines(largest: float) -> Array:
    """Return dampings from 0 to the largest that is stable, dense at both ends."""
    angle = np.linspace(0.0, _LAST_LINE * 0.5 * np.pi, _LINES)
    return largest * np.sin(angle) ** 2


@dataclasses.dataclass(frozen=True, eq=False)
class _Environment:
    """One environment with all that judges its couplings."""

    name: str
    stable: StableCouplings
    judge: CouplingJudge
    users: Users
    omega: Array  # rad/s, where `feels_real` looks first
    scene: Scene
    softest: float  # N/m: a softer coupling is too soft under every draw

    @classmethod
    def of(
        cls,
        stable: StableCouplings,
        name: str,
        users: Users,
        scene: Scene,
        within: tuple[float, float],
    ) -> _Environment:
        """Prepare an environment."""
        setup = stable.setup
        some = users.select(slice(0, _MAP_DRAWS))
        central = scene.verdict.central
        span = stiffness_span(setup, name, some, central)
        display = setup.display(name, coupled=True)
        omega = map_frequencies(setup, name, span, within)
        judge = CouplingJudge(display, some, omega, central=central)
        searched = frequencies(setup, name, relative_sd(users), within)
        return cls(name, stable, judge, users, searched, scene, _SOFTER * span.low)

    def confirm(self, coupling: Coupling) -> Evidence:
        """Judge one coupling by `feels_real`."""
        setup = dataclasses.replace(self.stable.setup, coupling=coupling)
        display = setup.display(self.name, coupled=True)
        some = self.users.select(slice(0, _END_DRAWS))
        central = self.scene.verdict.central
        decision = self.scene.inference.decision
        return feels_real(display, some, self.omega, central=central, decision=decision)


class _Grid(NamedTuple):
    """Couplings on B lines of damping, N·s/m, K stiffnesses each, N/m."""

    damping: Array  # (B,)
    stiffness: Array  # (B, K), increasing to the stable limit


def _stable_grid(stable: StableCouplings, damping: Array, softest: float) -> _Grid:
    """Return stable couplings from `softest`, N/m, on."""
    limit = (1.0 - _INSIDE) * np.maximum(stable.limit(damping), np.finfo(float).tiny)
    low = np.minimum(softest, limit / _LEAST_SPAN)
    return _Grid(damping, np.geomspace(low, limit, _STIFFNESSES).T)


def _map_of(
    name: str | None, environments: Sequence[_Environment], damping: Array
) -> EnvironmentCouplings:
    """Map one environment, or several together."""
    softest = max(environment.softest for environment in environments)
    grid = _stable_grid(environments[0].stable, damping, softest)
    probability = _probabilities(environments, grid)
    ends: dict[End, ConfirmedCoupling | None] = {}
    for end in ("stiffest", "softest"):
        ends[end] = _confirmed_end(environments, grid, probability, end)
    return EnvironmentCouplings(
        name=name,
        stiffness=grid.stiffness,
        probability=probability,
        stiffest=ends["stiffest"],
        softest=ends["softest"],
    )


def _probabilities(environments: Sequence[_Environment], grid: _Grid) -> Array:
    """Return P(stable) times the smallest of the environments' probabilities, (B, K)."""
    stiffness = grid.stiffness.ravel()
    damping = np.repeat(grid.damping, grid.stiffness.shape[1])
    stable = environments[0].stable.probability(stiffness, damping)
    least = np.where(stable > 0.0, 1.0, 0.0)
    for environment in environments:
        maybe = np.flatnonzero(least > 0.0)
        if maybe.size:
            couplings = environment.stable.setup.coupling_of(stiffness[maybe], damping[maybe])
            found = environment.judge.probabilities(couplings)
            least[maybe] = np.minimum(least[maybe], found)
    return (stable * least).reshape(grid.stiffness.shape)


def _confirmed_end(
    environments: Sequence[_Environment], grid: _Grid, probability: Array, end: End
) -> ConfirmedCoupling | None:
    """Return the stiffest or the softest coupling that `feels_real` confirms; None without one."""
    decision = environments[0].scene.inference.decision
    wanted = decision
    for _ in range(_TRIALS):
        coupling = _refined_end(environments, grid, probability, wanted, end)
        if coupling is None:
            return None
        confirmed = _confirmed(environments, coupling)
        stable = environments[0].stable.allows(coupling, decision)
        if confirmed.probability >= decision and stable:
            return confirmed
        # What lies between the map's frequencies, and its fewer draws, is asked for on top.
        wanted += max(decision - confirmed.probability, 1.0 / _END_DRAWS)
    return None


def _confirmed(environments: Sequence[_Environment], coupling: Coupling) -> ConfirmedCoupling:
    """Say how probably a coupling feels real where it is least probable, and what bounds it."""
    found = [environment.confirm(coupling) for environment in environments]
    least = min(found, key=lambda evidence: evidence.probability)
    stable = environments[0].stable.chance(coupling)
    bound: Literal["stability", "magnitude", "plane"] = "magnitude"
    at_edge = stable.nearness >= 1.0 - 2.0 * _INSIDE
    if at_edge or stable.probability < least.probability:
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
    environments: Sequence[_Environment],
    grid: _Grid,
    probability: Array,
    wanted: float,
    end: End,
) -> Coupling | None:
    """Return the end of what is as probable as wanted, on the lines of a map and between them."""
    setup = environments[0].stable.setup
    best = None
    for refinement in range(_REFINEMENTS + 1):
        ends = _ends_on_lines(environments, grid, probability, wanted, end)
        if not np.isfinite(ends).any():
            break
        line = int(np.nanargmin(ends) if end == "softest" else np.nanargmax(ends))
        best = setup.coupling_of(float(ends[line]), float(grid.damping[line]))
        if refinement < _REFINEMENTS:
            neighbours = grid.damping[max(line - 1, 0) : line + 2]
            between = np.linspace(neighbours[0], neighbours[-1], _LINES_BETWEEN)
            between = np.union1d(between, best.damping)  # so that no refined end is worse
            grid = _stable_grid(environments[0].stable, between, float(grid.stiffness.min()))
            probability = _probabilities(environments, grid)
    return best


def _ends_on_lines(
    environments: Sequence[_Environment],
    grid: _Grid,
    probability: Array,
    wanted: float,
    end: End,
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
        found = _probabilities(environments, _Grid(grid.damping[lines], middle[:, None]))[:, 0]
        inside = np.where(found >= wanted, middle, inside)
        outside = np.where(found >= wanted, outside, middle)
    ends[lines] = inside
    return ends


def no_other_devices(setup: Setup, users: Mapping[str, Users]) -> Skipped | None:
    """Say why mass and damping are not varied; None where they are."""
    what = "verdicts with other mass and damping of the device"
    if not isinstance(setup.device, Device):
        return Skipped(what, "a measured response has neither")
    if not users:
        return Skipped(what, "they need a joint law of stiffness and damping")
    return None


def other_devices(
    setup: Setup,
    users: Mapping[str, Users],
    method: Method,
    scene: Scene,
    within: tuple[float, float],
) -> OtherDevices | None:
    """Judge every environment again with other mass and damping of the device.

    Parameters
    ----------
    setup : Setup
        Device, coupling and references.
    users : mapping of str to Users
        Draws of the population, in random order, by environment.
    method : {"bayesian", "classical"}
        Whose draws these are.
    scene : Scene
        With the central share and the decision.
    within : tuple of float
        Ends of the frequencies that displays are judged over, rad/s.

    Returns
    -------
    OtherDevices or None
        None where `no_other_devices` says why.
    """
    if no_other_devices(setup, users) is not None:
        return None
    setups = list(_setups(setup))
    stable = None
    if setup.coupling is not None:
        stable = tuple(is_stable(varied, setup.coupling) for varied in setups)
    devices = [varied.device for varied in setups if isinstance(varied.device, Device)]
    central = scene.verdict.central
    decision = scene.inference.decision
    verdicts = []
    for environment, population in users.items():
        some = population.select(slice(0, _DEVICE_DRAWS))
        for coupled in (False, True) if setup.coupling is not None else (False,):
            probabilities = tuple(
                _probability(varied, environment, some, central, within, coupled=coupled)
                for varied in setups
            )
            verdict = ChangedVerdict(
                environment=environment,
                coupled=coupled,
                probability=probabilities,
                outcome=tuple(judge(one, decision) for one in probabilities),
            )
            verdicts.append(verdict)
    return OtherDevices(
        mass=tuple(float(device.mass) for device in devices),
        damping=tuple(float(device.damping) for device in devices),
        stable=stable,
        verdicts=tuple(verdicts),
        method=method,
        draws=min(_DEVICE_DRAWS, *(population.size for population in users.values())),
    )


def _setups(setup: Setup) -> Iterator[Setup]:
    """Yield the scene's own device, then less and more mass, then less and more damping."""
    device = setup.device
    assert isinstance(device, Device)
    devices = [device]
    for factor in (_LESS, _MORE):
        devices.append(dataclasses.replace(device, mass=factor * device.mass))
    for factor in (_LESS, _MORE):
        devices.append(dataclasses.replace(device, damping=factor * device.damping))
    for other in devices:
        yield dataclasses.replace(setup, device=other)


def _probability(
    setup: Setup,
    environment: str,
    users: Users,
    central: float,
    within: tuple[float, float],
    *,
    coupled: bool,
) -> float:
    """Judge one environment on one device."""
    span = stiffness_span(setup, environment, users, central)
    omega = map_frequencies(setup, environment, span, within)
    display = setup.display(environment, coupled=coupled)
    return rough_probability(display, users, omega, central=central)
