"""Curves of abs(Z_h) averaged over what is known of the device, and the part that it makes.

Limits are found with the device at its point. Points that stand for the law of (k, b) are then put
on devices of the posterior, each on another one, and all on the device at its point. The difference
between both sets of limits has far less noise than either, and is added to the limits.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from percept.boundary.limits import MagnitudeLimits
from percept.haptics.perceived import perceived_magnitude
from percept.haptics.records import AnyDevice
from percept.study.basics import Array
from percept.study.device import Setup
from percept.study.regions import Law

#: Points of the law of (k, b), as many as devices are drawn: limits are known to 0.02 of a band's
#: half-width by them.
_POINTS = 4096
#: Runs of points with their devices, whose scatter gives the error.
_BATCHES = 8
#: N·s/m that count as zero, and still have a logarithm.
_SMALLEST = np.finfo(np.float64).tiny


@dataclasses.dataclass(frozen=True, eq=False)
class _Curves:
    """P curves of log abs(Z_h) with their probabilities, in order at each of M frequencies."""

    logs: Array  # (M, P) increasing along a row
    scores: Array  # (M, P) normal scores of the probability below
    farthest: Array  # (P,) largest score of each curve, of either sign
    probability: Array  # (P,)

    @classmethod
    def of(cls, logs: Array, probability: Array) -> _Curves:
        """Put curves in order."""
        order = logs.argsort(axis=1)
        weights = probability[order] / probability.sum()
        below = np.cumsum(weights, axis=1) - 0.5 * weights
        scores = special.ndtri(below)
        by_curve = np.empty_like(scores)
        np.put_along_axis(by_curve, order, scores, axis=1)
        farthest = np.abs(by_curve).max(axis=0)
        return cls(np.take_along_axis(logs, order, axis=1), scores, farthest, probability)

    def limits(self, score: float) -> Array:
        """Return the log limits (2, M) at a score."""
        ends = [-score, score]
        limits = []
        for scores, logs in zip(self.scores, self.logs, strict=True):
            limits.append(np.interp(ends, scores, logs))
        return np.array(limits).T

    def score_that_holds(self, level: float) -> float:
        """Return the score of the limits that hold whole curves with a probability."""
        order = self.farthest.argsort()
        inside = np.cumsum(self.probability[order])
        return float(np.interp(level * inside[-1], inside, self.farthest[order]))


class DeviceCurves:
    """Curves of one law of (k, b), at frequencies (M,), rad/s, on devices of the posterior."""

    def __init__(self, setup: Setup, law: Law, omega: Array) -> None:
        assert setup.draws is not None
        k, b, probability = law.pair.even(_POINTS)
        device = np.arange(_POINTS) % np.size(setup.draws.mass)
        mass = float(setup.references[law.environment].mass)

        def logs(held: AnyDevice) -> Array:
            loop = dataclasses.replace(setup.loop, device=held)
            magnitude = perceived_magnitude(loop, omega[:, None], k, b, mass=mass)
            return np.log(np.maximum(magnitude, _SMALLEST))

        at_point = logs(setup.loop.device)
        on_devices = logs(setup.draws.select(device))
        # All points, then runs of them. Points and devices are even in every run; every eighth
        # device would not be.
        run = _POINTS // _BATCHES
        parts = [slice(start, start + run) for start in range(0, _POINTS, run)]
        self._omega = omega
        self._at_point = []
        self._on_devices = []
        for part in (slice(None), *parts):
            of_part = probability[part]
            self._at_point.append(_Curves.of(at_point[:, part], of_part))
            self._on_devices.append(_Curves.of(on_devices[:, part], of_part))

    def widening(self, level: float) -> float:
        """Return by how much the score grows whose limits hold whole curves."""
        with_devices = self._on_devices[0].score_that_holds(level)
        return with_devices - self._at_point[0].score_that_holds(level)

    def averaged(
        self, limits: MagnitudeLimits, score: float, widening: float = 0.0
    ) -> MagnitudeLimits:
        """Average limits over the device's posterior.

        Parameters
        ----------
        limits : MagnitudeLimits
            With the device at its point, from posterior draws of (k, b).
        score : float
            Their score.
        widening : float
            By how much the score grows.

        Returns
        -------
        MagnitudeLimits
            With the device's share of their squared width, a mean over log omega.
        """
        shifts = []
        for at_point, on_devices in zip(self._at_point, self._on_devices, strict=True):
            # Limits that are infinite stay so.
            with np.errstate(invalid="ignore"):
                shift = on_devices.limits(score + widening) - at_point.limits(score)
            shifts.append(np.where(np.isfinite(shift), shift, 0.0))
        lower, upper = np.exp(shifts[0])
        scatter = np.std(shifts[1:], axis=0, ddof=1)
        assert limits.errors is not None
        averaged = MagnitudeLimits(
            limits.lower * lower,
            limits.upper * upper,
            np.hypot(limits.errors, scatter / np.sqrt(_BATCHES)),
        )
        share = self._share(limits, averaged)
        return dataclasses.replace(averaged, device_share=share)

    def _share(self, at_point: MagnitudeLimits, averaged: MagnitudeLimits) -> float:
        """Return the share of the squared log width that the device makes."""
        wide = np.isfinite(averaged.upper)
        wide &= averaged.upper > averaged.lower
        before = np.log(at_point.upper[wide] / at_point.lower[wide])
        after = np.log(averaged.upper[wide] / averaged.lower[wide])
        share = 1.0 - (before / after) ** 2
        lengths = np.ones(share.size)
        if share.size > 1:
            lengths = np.gradient(np.log(self._omega[wide]))
        mean = np.average(share, weights=lengths)
        return float(np.clip(mean, 0.0, 1.0))
