"""Boundaries of a study: curves around every region, and of every law, of (k, b), on one grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator

import numpy as np

from percept.boundary.limits import Magnitude, MagnitudeLimits, relative_error
from percept.boundary.shares import score_of
from percept.errors import RefusalError
from percept.haptics.loop import log_grid
from percept.results import BandPair, Boundary, Shape, Skipped
from percept.scene import FrequencyTable
from percept.study.basics import Array
from percept.study.device import Setup
from percept.study.regions import Law, Region, claim_fields

_LAW_SHAPES: tuple[Shape, ...] = ("pointwise", "simultaneous")
#: Curves are not drawn when their Monte Carlo error exceeds this many times the tolerance.
_MOST_TOLERANCES = 10.0
#: Frequencies per decade: a line through them shows no corners on a page.
_PER_DECADE = 40
#: Beside a resonance curves bend within a few per cent of its omega.
_BESIDE = 1.0 + np.array([-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04])


@dataclasses.dataclass(frozen=True, eq=False)
class _Frame:
    """What all curves of one environment share."""

    omega: Array  # (M,) rad/s
    reference: Array  # (M,) abs(Z_h) of the reference, N·s/m
    coupled: Array | None  # (M,) through the coupling, N·s/m

    @classmethod
    def of(cls, setup: Setup, environment: str, omega: Array) -> _Frame:
        """Take an environment at frequencies, rad/s."""
        reference = setup.curve(environment, omega, coupled=False)
        coupled = None
        if setup.coupling is not None:
            coupled = setup.curve(environment, omega, coupled=True)
        return cls(omega, reference, coupled)


@dataclasses.dataclass(frozen=True, eq=False)
class BoundaryDrawing:
    """Boundaries of environments over a range, each environment's on one grid of its own."""

    setup: Setup
    regions: Collection[Region]  # What corner curves and envelopes go around
    laws: Collection[Law]  # What pointwise and simultaneous limits come from
    table: FrequencyTable
    tolerance: float  # Monte Carlo error that the scene asks for, as a fraction of a half-width

    def drawn(self, environments: Collection[str]) -> Iterator[Boundary | Skipped]:
        """Yield all boundaries of environments, on grids of their own, and curves left out."""
        for environment in environments:
            frame = _Frame.of(self.setup, environment, self._grid(environment))
            for region in self.regions:
                if region.environment == environment:
                    yield from self._around(region, frame)
            for law in self.laws:
                if law.environment == environment:
                    yield from self._of_law(law, frame)

    def _grid(self, environment: str) -> Array:
        """Return frequencies, rad/s, dense about resonances unless the scene sets their number."""
        lower = self.table.lower
        upper = self.table.upper
        if self.table.points:
            return np.geomspace(lower, upper, self.table.points)
        about_resonances = np.multiply.outer(self.setup.resonances(environment), _BESIDE)
        omega = log_grid((lower, upper), _PER_DECADE, about_resonances.ravel())
        # At a pole curves are infinite, and no line leads there.
        finite = np.isfinite(self.setup.curve(environment, omega, coupled=False))
        finite &= np.isfinite(self.setup.curve(environment, omega, coupled=True))
        return omega[finite]

    def _around(self, region: Region, frame: _Frame) -> Iterator[Boundary]:
        """Yield the curves around a region of (k, b)."""
        # An ellipse has no corners.
        shapes: tuple[Shape, ...] = ("corner", "envelope") if region.limits else ("envelope",)
        for shape in shapes:
            limits = MagnitudeLimits(*self.setup.outline(region, shape, frame.omega))
            yield _boundary(region, region.joint, shape, limits, frame)

    def _of_law(self, law: Law, frame: _Frame) -> Iterator[Boundary | Skipped]:
        """Yield limits at single frequencies, and those between which whole curves lie.

        Bayesian limits average over the device's posterior. A classical level counts repetitions of
        the study, and a posterior has none.
        """
        setup = self.setup
        bayesian = law.method == "bayesian"
        mass = float(setup.references[law.environment].mass)
        devices = setup.draws if bayesian else None
        magnitude = Magnitude(law.pair, setup.loop, frame.omega, mass=mass, devices=devices)
        found: list[Boundary] = []
        try:
            pointwise = magnitude.limits(score_of(law.level))
            found.append(_boundary(law, "joint", "pointwise", pointwise, frame))
            if bayesian:
                whole = magnitude.limits(*magnitude.simultaneous_score(law.level))
            elif law.region is None:
                raise RefusalError("the subjects' values give no ellipse.")
            else:
                # What holds (k, b) holds the whole curve. A calibrated level of the t law covers
                # too little: 87 % of users where 90 % is stated.
                whole = MagnitudeLimits(*setup.outline(law.region, "envelope", frame.omega))
            whole = whole.joined(pointwise)
            found.append(_boundary(law, "joint", "simultaneous", whole, frame))
        except RefusalError as refusal:
            for shape in _LAW_SHAPES[len(found) :]:
                yield Skipped(_law_name(law, shape), refusal.message.removesuffix("."))
        largest_error = _MOST_TOLERANCES * self.tolerance
        for boundary in found:
            error = boundary.error
            if error is None or error <= largest_error:
                yield boundary
                continue
            why = f"their Monte Carlo error is {error:.2g} of the half-width,"
            why += f" and curves are drawn up to {largest_error:.2g}"
            yield Skipped(_law_name(law, boundary.shape), why)


def envelopes(setup: Setup, regions: Iterable[Region], omega: Array) -> Iterator[Boundary]:
    """Yield exact envelopes of k and b each at its level, at frequencies (M,), rad/s."""
    for region in regions:
        if region.joint == "marginal":
            frame = _Frame.of(setup, region.environment, omega)
            limits = MagnitudeLimits(*setup.outline(region, "envelope", omega))
            yield _boundary(region, region.joint, "envelope", limits, frame)


def _boundary(
    source: Region | Law, joint: str, shape: Shape, limits: MagnitudeLimits, frame: _Frame
) -> Boundary:
    """Put limits together with what they were drawn for."""
    return Boundary(
        **claim_fields(source),
        joint=joint,
        shape=shape,
        omega=frame.omega,
        lower=limits.lower,
        upper=limits.upper,
        reference=frame.reference,
        coupled=frame.coupled,
        error=relative_error(frame.omega, limits),
        device_share=limits.device_share,
    )


def _law_name(law: Law, shape: Shape) -> str:
    """Name the curves of a law, as "Not computed" lists them."""
    if law.method == "bayesian":
        return f"{shape} Bayesian curves of {law.environment}, kind {law.kind}"
    return f"{shape} classical curves of {law.environment}, kind {law.kind}, {law.family}"


def band_pairs(
    first: Collection[Boundary], second: Collection[Boundary], *labels: str
) -> Iterator[BandPair]:
    """Yield how exact envelopes of the second differ from those of the first with equal labels.

    Both stand at the same frequencies. Bands without width, and infinite ones, are left out.
    """
    others = {
        tuple(getattr(boundary, name) for name in labels): boundary
        for boundary in _envelopes(first)
    }
    for band in _envelopes(second):
        other = others.get(tuple(getattr(band, name) for name in labels))
        if other is not None:
            middles = (band.lower + band.upper) / (other.lower + other.upper)
            yield BandPair(
                environment=band.environment,
                kind=band.kind,
                method=band.method,
                family=band.family,
                **_difference("place", band.omega, middles - 1.0),
                **_difference("width", band.omega, np.log(band.band / other.band)),
            )


def _envelopes(boundaries: Collection[Boundary]) -> Iterator[Boundary]:
    """Yield exact envelopes that have a width."""
    for boundary in boundaries:
        if boundary.shape == "envelope" and boundary.joint == "marginal":
            limits = np.array([boundary.lower, boundary.upper])
            if np.isfinite(limits).all() and np.all(limits[1] > limits[0]):
                yield boundary


def _difference(name: str, omega: Array, values: Array) -> dict[str, float]:
    """Return how a measure of two bands goes over omega, as fields of `BandPair`."""
    index = int(np.argmax(np.abs(values)))
    # The median is over log omega: grids are dense where curves bend.
    order = np.argsort(values)
    log_lengths = np.gradient(np.log(omega))[order]
    below = np.cumsum(log_lengths) - 0.5 * log_lengths
    median = float(np.interp(0.5 * log_lengths.sum(), below, values[order]))
    return {
        name: float(values[index]),
        f"{name}_omega": float(omega[index]),
        f"{name}_median": median,
    }
