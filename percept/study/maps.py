"""How probably other couplings feel real and are stable in time, and what other devices change.

The map of couplings is over stiffness and damping, for each environment up to the edge of what is
stable with it. Where the device has a posterior, the edge is that of its most stable draw. The ends
of a map are the stiffest and the softest coupling that feel real with the scene's `decision`. They
are found on its lines of damping and confirmed by `percept.boundary.feels_real`, which also
searches between frequencies.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from percept.boundary.couplings import CouplingJudge
from percept.boundary.feels_real import MAP_DRAWS, Evidence, share_error
from percept.boundary.shares import Users
from percept.haptics import Coupling, Device, Environment, TabulatedDevice, can_render
from percept.haptics.loop import log_grid
from percept.results import (
    AdmissibleCouplings,
    ChangedVerdict,
    ConfirmedCoupling,
    EnvironmentCouplings,
    OtherDevices,
    Skipped,
)
from percept.scene import Scene
from percept.study.basics import Array
from percept.study.device import Setup
from percept.study.rendering import StableCouplings
from percept.study.verdicts import MapUsers, evidence_of

#: Draws that confirm an end: on a line of equal probability no number of draws is ever clear of it.
_END_DRAWS = (512, 1024, 2048)
#: Standard errors by which a probability surely differs from the decision.
_ERRORS = 2.0
#: Lines of damping of a map, on which its ends lie, and stiffnesses on each: over the least span
#: 6 % apart.
_LINES = 33
_STIFFNESSES = 41
#: The last line is a hair's breadth below the largest stable damping, where nothing is left.
_LAST_LINE = 0.98
#: A coupling at the edge of what is stable is pulled inside by this fraction of its stiffness.
_PULLED_IN = 1e-4
#: From this fraction of an edge's stiffness on, a coupling counts as standing at the edge.
_AT_EDGE = 1.0 - 2.0 * _PULLED_IN
#: The softest coupling of a map, against the softest stiffness in users' ranges.
_SOFTER = 0.5
#: A line of a map spans this factor of stiffness at least, also where little is stable.
_LEAST_SPAN = 10.0
#: Halvings of the step of a map that holds an end: the stiffness is known to a ten-thousandth.
_HALVINGS = 10
#: Ends that are tried, each from a higher probability on, before a search gives up.
_ENDS_TRIED = 5
#: Frequencies of a map, per decade: twice as many change probabilities by a hundredth at most.
_PER_DECADE = 4
#: About each resonance, where margins dip: half as many change probabilities by a tenth.
_ABOUT_RESONANCE = 25
#: Quantiles over draws of the ends of users' stiffness, between which resonances are looked for.
_COMMON_QUANTILES = (0.05, 0.95)
#: Resonances are looked for down to this fraction of the reference's stiffness.
_SOFTEST_RESONANCE = 0.01
#: Factors of the scene's mass or damping: these are seldom known better than to a half.
_FACTORS = (0.5, 1.5)

End = Literal["stiffest", "softest"]
_ENDS: tuple[End, ...] = ("stiffest", "softest")


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
    if not StableCouplings(setup, list(whose.draws)).largest_damping():
        return Skipped(what, "no coupling is stable in time with this device")
    return None


def coupling_map(setup: Setup, whose: MapUsers, scene: Scene) -> AdmissibleCouplings | None:
    """Map how probably stable couplings feel real in each environment.

    None where `no_coupling_map` says why.
    """
    if no_coupling_map(setup, whose) is not None:
        return None
    maps = {name: _Map(setup, name, users, scene) for name, users in whose.draws.items()}
    found = [its_map.worked_out() for its_map in maps.values()]
    return AdmissibleCouplings(
        method=whose.method,
        decision=scene.inference.decision,
        environments=tuple(found),
        together=_serving_all(setup, scene, maps, found),
        devices=setup.draw_count,
    )


def _users_stiffnesses(
    setup: Setup, environment: str, users: Users, central: float
) -> tuple[float, float]:
    """Return between which stiffnesses users take for an environment under most draws, N/m."""
    ranges = users.central_ranges(central).stiffness
    reference = float(setup.references[environment].stiffness)
    low = float(np.quantile(ranges.low, _COMMON_QUANTILES[0]))
    high = float(np.quantile(ranges.high, _COMMON_QUANTILES[1]))
    least = max(low, _SOFTEST_RESONANCE * reference)
    return least, max(high, least)


def _map_frequencies(
    setup: Setup, environment: str, ends: tuple[float, float], scene: Scene
) -> Array:
    """Return the frequencies, rad/s, of a map: even ones, and those at which users' walls resonate.

    These walls are between two stiffnesses, N/m.
    Dips between them are not searched, so they are denser about resonances than `frequencies`.
    """
    resonances = setup.resonances(environment)
    if not isinstance(setup.loop.device, TabulatedDevice):
        # A table's rows are all there is to see; a mass resonates by the root of the stiffness.
        about = np.sqrt(
            np.geomspace(*ends, _ABOUT_RESONANCE) / setup.references[environment].stiffness
        )
        resonances = np.multiply.outer(resonances, about).ravel()
    return log_grid((scene.frequency.lower, scene.frequency.upper), _PER_DECADE, resonances)


class _Map:
    """Couplings of one environment: B lines of damping, N·s/m, of K stiffnesses each, N/m.

    They reach up to what is stable. Their probability (B, K) is that of being stable, times that of
    feeling real.
    """

    def __init__(self, setup: Setup, name: str, users: Users, scene: Scene) -> None:
        self._setup = setup
        self._name = name
        self._scene = scene
        self._decision = scene.inference.decision
        #: What serves all environments may be an end of this one.
        self.confirm = functools.cache(self._confirm)
        self.users = users
        few_users = users.select(slice(MAP_DRAWS[0]))
        central = scene.verdict.central
        ends = _users_stiffnesses(setup, name, few_users, central)
        omega = _map_frequencies(setup, name, ends, scene)
        display = setup.display(name, coupled=True)
        most_users = users.select(slice(MAP_DRAWS[-1]))
        self.couplings = CouplingJudge(display, most_users, omega, central=central)
        self._stable = StableCouplings(setup, [name])
        # Lines are dense at both ends.
        angle = np.linspace(0.0, _LAST_LINE * 0.5 * np.pi, _LINES)
        self._damping = self._stable.largest_damping() * np.sin(angle) ** 2
        limit = np.maximum(self._stable.limit(self._damping), np.finfo(float).tiny)
        limit *= 1.0 - _PULLED_IN
        self._limited = bool(limit[0] < _AT_EDGE * self._stable.rigid_stiffness)
        # A coupling as soft is too soft under every draw.
        low = np.minimum(_SOFTER * ends[0], limit / _LEAST_SPAN)
        self._stiffness = np.geomspace(low, limit, _STIFFNESSES).T

    def worked_out(self) -> EnvironmentCouplings:
        """Judge all couplings; by more draws where the first do not decide."""
        for draws in MAP_DRAWS:
            self.draws = min(draws, self.users.size)
            self.probability = self._probabilities(self._stiffness, self._damping)
            ends = {end: self._confirmed_end(end) for end in _ENDS}
            highest = float(self.probability.max())
            outcome: Literal["some", "none", "undecided"] = "undecided"
            if None not in ends.values():
                outcome = "some"
            elif highest + _ERRORS * share_error(highest, self.draws) < self._decision:
                outcome = "none"
            if outcome != "undecided":
                break
            self.couplings.only_deciding()
        return EnvironmentCouplings(
            name=self._name,
            damping=self._damping,
            stiffness=self._stiffness,
            probability=self.probability,
            limited=self._limited,
            outcome=outcome,
            draws=self.draws,
            **ends,
        )

    def _confirm(self, coupling: Coupling) -> Evidence:
        """Judge one coupling between frequencies too, with the device at its point."""
        setup = dataclasses.replace(self._setup, coupling=coupling, draws=None)
        return evidence_of(
            setup, self._name, self.users, self._scene, coupled=True, draws=_END_DRAWS, brief=True
        )

    def _probabilities(self, stiffness: Array, damping: Array) -> Array:
        """Return the probabilities of stiffnesses (B, K) on lines (B,)."""
        flat = stiffness.ravel()
        damping_of_each = np.repeat(damping, stiffness.shape[1])
        stable = np.ones(flat.size)
        if self._stable.devices is not None:
            stable = self._stable.probability(flat, damping_of_each)
        maybe = np.flatnonzero(stable)
        if maybe.size:
            couplings = Coupling(flat[maybe], damping_of_each[maybe])
            stable[maybe] *= self.couplings.probabilities(couplings, self.draws)
        return stable.reshape(stiffness.shape)

    def _confirmed_end(self, end: End) -> ConfirmedCoupling | None:
        """Return the stiffest or the softest coupling that surely reaches the decision."""
        wanted = self._decision + _ERRORS * share_error(self._decision, _END_DRAWS[-1])
        for _ in range(_ENDS_TRIED):
            coupling = self._probable_end(end, wanted)
            if coupling is None:
                return None
            confirmed = _confirmed([self], self._stable, coupling)
            least_probability = confirmed.probability - _ERRORS * confirmed.error
            if least_probability >= self._decision:
                return confirmed
            # What lies between the map's frequencies, and its fewer draws, is asked for on top.
            wanted += max(self._decision - least_probability, 1.0 / _END_DRAWS[-1])
        return None

    def _probable_end(self, end: End, wanted: float) -> Coupling | None:
        """Return the stiffest or the softest coupling on a line that is as probable as wanted."""
        enough = self.probability >= wanted
        stiffness = self._stiffness
        if end == "stiffest":
            # From the outer end of each line.
            enough = np.fliplr(enough)
            stiffness = np.fliplr(stiffness)
        (lines,) = np.nonzero(enough.any(axis=1))
        if not lines.size:
            return None
        damping = self._damping[lines]
        first = enough[lines].argmax(axis=1)
        inside = stiffness[lines, first]
        outside = stiffness[lines, np.maximum(first - 1, 0)]
        for _ in range(_HALVINGS):
            middle = np.sqrt(inside * outside)
            probability = self._probabilities(middle[:, None], damping)[:, 0]
            inside = np.where(probability >= wanted, middle, inside)
            outside = np.where(probability >= wanted, outside, middle)
        best_line = inside.argmax() if end == "stiffest" else inside.argmin()
        return Coupling(float(inside[best_line]), float(damping[best_line]))


def _confirmed(
    maps: Sequence[_Map], stable: StableCouplings, coupling: Coupling
) -> ConfirmedCoupling:
    """Say how probably a coupling feels real where it is least probable, and what bounds it."""
    least = min((one.confirm(coupling) for one in maps), key=lambda found: found.probability)
    stiffness = np.atleast_1d(coupling.stiffness)
    damping = np.atleast_1d(coupling.damping)
    chance = float(stable.probability(stiffness, damping)[0])
    # One device is exact.
    devices = stable.devices
    stable_error = share_error(chance, devices) if devices else 0.0
    bound: Literal["stability", "magnitude", "plane", "map"] = "magnitude"
    if stable.at_nyquist(coupling) >= _AT_EDGE * stable.rigid_at_nyquist:
        bound = "map"
    elif stiffness >= _AT_EDGE * stable.limit(damping) or chance < least.probability:
        bound = "stability"
    elif least.plane < least.magnitude:
        bound = "plane"
    return ConfirmedCoupling(
        stiffness=float(stiffness[0]),
        damping=float(damping[0]),
        probability=chance * least.probability,
        error=float(np.hypot(least.error, stable_error)),
        draws=least.draws,
        bound=bound,
    )


def _serving_all(
    setup: Setup, scene: Scene, maps: Mapping[str, _Map], found: Sequence[EnvironmentCouplings]
) -> ConfirmedCoupling | None:
    """Return an end of a map that surely serves every environment that some coupling serves."""
    served = {one.name: maps[one.name] for one in found if one.outcome == "some"}
    if len(served) < 2:
        return None
    ends = [end for one in found for end in (one.softest, one.stiffest) if end]
    stiffness = np.array([end.stiffness for end in ends])
    damping = np.array([end.damping for end in ends])
    stable = StableCouplings(setup, list(served))
    least = stable.probability(stiffness, damping)
    for its_map in served.values():
        draws = min(MAP_DRAWS[0], its_map.users.size)
        real = its_map.couplings.probabilities(Coupling(stiffness, damping), draws)
        least = np.minimum(least, real)
    best = ends[int(least.argmax())]
    together = _confirmed(list(served.values()), stable, Coupling(best.stiffness, best.damping))
    surely = together.probability - _ERRORS * together.error
    return together if surely >= scene.inference.decision else None


def no_other_devices(setup: Setup, whose: MapUsers) -> Skipped | None:
    """Say why mass and damping are not varied; None where they are."""
    what = "verdicts with other mass and damping of the device"
    if not isinstance(setup.loop.device, Device):
        return Skipped(what, "a measured response has neither")
    if not whose.draws:
        return Skipped(what, "they need a joint law of stiffness and damping")
    return None


def other_devices(setup: Setup, whose: MapUsers, scene: Scene) -> OtherDevices | None:
    """Judge again with other mass and damping of the device what one of these devices renders.

    None where `no_other_devices` says why.
    """
    device = setup.loop.device
    if not isinstance(device, Device) or not whose.draws:
        return None
    devices = [device]
    devices += [dataclasses.replace(device, mass=factor * device.mass) for factor in _FACTORS]
    devices += [dataclasses.replace(device, damping=factor * device.damping) for factor in _FACTORS]
    setups = [dataclasses.replace(setup.with_device(other), draws=None) for other in devices]
    verdicts = []
    for environment, coupled in setup.displays():
        if environment not in whose.draws:
            continue
        rendered = []
        for varied in setups:
            display = varied.display(environment, coupled=coupled)
            found = can_render(varied.loop, display.environment, coupling=display.coupling)
            rendered.append(found.verdict == "can")
        if not any(rendered):
            continue
        users = whose.draws[environment]
        probabilities = [
            evidence_of(
                varied, environment, users, scene, coupled=coupled, draws=MAP_DRAWS, brief=True
            ).probability
            for varied in setups
        ]
        verdict = ChangedVerdict(
            environment=environment,
            coupled=coupled,
            probability=tuple(probabilities),
            rendered=tuple(rendered),
        )
        verdicts.append(verdict)
    return OtherDevices(
        mass=tuple(float(other.mass) for other in devices),
        damping=tuple(float(other.damping) for other in devices),
        coupled=setup.coupling is not None,
        verdicts=tuple(verdicts),
        method=whose.method,
        draws=min(MAP_DRAWS[0], *(population.size for population in whose.draws.values())),
    )
