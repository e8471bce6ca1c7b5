"""Boundaries of a study: curves around every region, and of every law, of (k, b), on one grid."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator

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


class BoundaryDrawing:
    """Boundaries of environments over a range, each environment's on one grid of its own.

    Parameters
    ----------
    setup : Setup
        Device, coupling and references.
    regions : collection of Region
        What corner curves and envelopes go around.
    laws : collection of Law
        What pointwise and simultaneous limits come from.
    table : FrequencyTable
        The scene's range of omega.
    tolerance : float
        Monte Carlo error that the scene asks for, as a fraction of a half-width.
    """

    def __init__(
        self,
        setup: Setup,
        regions: Collection[Region],
        laws: Collection[Law],
        table: FrequencyTable,
        tolerance: float,
    ) -> None:
        self._setup = setup
        self._regions = regions
        self._laws = laws
        self._table = table
        self._largest_error = _MOST_TOLERANCES * tolerance
        self._skipped: dict[str, str] = {}

    def drawn(self, environments: Collection[str]) -> Iterator[Boundary]:
        """Yield all boundaries of environments, on grids of their own."""
        for environment in environments:
            frame = self._frame(environment, self._grid(environment))
            for region in self._regions:
                if region.environment == environment:
                    yield from self._around(region, frame)
            for law in self._laws:
                if law.environment == environment:
                    yield from self._of_law(law, frame)

    def envelopes(self, omega: Array) -> Iterator[Boundary]:
        """Yield exact envelopes of k and b each at its level, at frequencies (M,), rad/s."""
        for region in self._regions:
            if region.joint == "marginal":
                frame = self._frame(region.environment, omega)
                limits = MagnitudeLimits(*self._setup.outline(region, "envelope", omega))
                yield _boundary(region, region.joint, "envelope", limits, frame)

    @property
    def skipped(self) -> list[Skipped]:
        """Curves of laws that were asked for and are not drawn, and why."""
        return [Skipped(what, why) for what, why in self._skipped.items()]

    def _grid(self, environment: str) -> Array:
        """Return frequencies, rad/s, dense about resonances unless the scene sets their number."""
        lower = self._table.lower
        upper = self._table.upper
        if self._table.points:
            return np.geomspace(lower, upper, self._table.points)
        about_resonances = np.multiply.outer(self._setup.resonances(environment), _BESIDE)
        omega = log_grid((lower, upper), _PER_DECADE, about_resonances.ravel())
        # At a pole curves are infinite, and no line leads there.
        finite = np.isfinite(self._setup.curve(environment, omega, coupled=False))
        finite &= np.isfinite(self._setup.curve(environment, omega, coupled=True))
        return omega[finite]

    def _frame(self, environment: str, omega: Array) -> _Frame:
        """Return what all curves of an environment share at frequencies, rad/s."""
        reference = self._setup.curve(environment, omega, coupled=False)
        coupled = None
        if self._setup.coupling is not None:
            coupled = self._setup.curve(environment, omega, coupled=True)
        return _Frame(omega, reference, coupled)

    def _around(self, region: Region, frame: _Frame) -> Iterator[Boundary]:
        """Yield the curves around a region of (k, b)."""
        # An ellipse has no corners.
        shapes: tuple[Shape, ...] = ("corner", "envelope") if region.limits else ("envelope",)
        for shape in shapes:
            limits = MagnitudeLimits(*self._setup.outline(region, shape, frame.omega), None)
            yield _boundary(region, region.joint, shape, limits, frame)

    def _of_law(self, law: Law, frame: _Frame) -> Iterator[Boundary]:
        """Yield limits at single frequencies, and those between which whole curves lie.

        Bayesian limits average over the device's posterior. A classical level counts repetitions of
        the study, and a posterior has none.
        """
        setup = self._setup
        bayesian = law.method == "bayesian"
        mass = float(setup.references[law.environment].mass)
        devices = setup.draws if bayesian else None
        magnitude = Magnitude(law.pair, setup.loop, frame.omega, mass=mass, devices=devices)
        found: list[Boundary] = []
        try:
            pointwise = magnitude.limits(score_of(law.level))
            found.append(_boundary(law, "joint", "pointwise", pointwise, frame))
            level = level_error = None
            if bayesian:
                simultaneous = magnitude.simultaneous_score(law.level)
                level = simultaneous.level
                level_error = simultaneous.level_error
                whole = magnitude.limits(simultaneous.score, simultaneous.shifts)
            elif law.region is None:
                raise RefusalError("the subjects' values give no ellipse.")
            else:
                # What holds (k, b) holds the whole curve. A calibrated level of the t law covers
                # too little: 87 % of users where 90 % is stated.
                whole = MagnitudeLimits(*setup.outline(law.region, "envelope", frame.omega))
            boundary = _boundary(law, "joint", "simultaneous", whole.joined(pointwise), frame)
            boundary = dataclasses.replace(
                boundary, pointwise_level=level, pointwise_level_error=level_error
            )
            found.append(boundary)
        except RefusalError as refusal:
            for shape in _LAW_SHAPES[len(found) :]:
                self._skipped[_law_name(law, shape)] = refusal.message.removesuffix(".")
        for boundary in found:
            error = boundary.error
            if error is None or error <= self._largest_error:
                yield boundary
                continue
            self._skipped[_law_name(law, boundary.shape)] = (
                f"their Monte Carlo error is {error:.2g} of the half-width,"
                f" and curves are drawn up to {self._largest_error:.2g}"
            )


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
        errors=limits.errors,
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
