"""Populations of users, and the share of them whose abs(Z_h) is at most what a display shows.

A population is a normal law of (k, b), or of their logarithms. abs(Z_h) is a distance in the plane
of (b, k/Omega), so the users with at most a given abs(Z_h) lie in a disc. The share is an integral
over one of k and b, by Gauss-Legendre nodes; the other has a normal law given the first.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.haptics.containment import Boxes
from percept.haptics.perceived import DistancePlane

__all__ = ["DiscIntegral", "Users", "choose_integral", "share_within"]

Array = NDArray[np.float64]

#: Beyond so many SDs lies less than 1e-12 of a population.
_FARTHEST = 7.2
#: Nodes tried, from the fewest on; narrow discs in wide populations need the last.
_NODE_COUNTS = (12, 24, 48, 96, 192, 384)
#: Shares are as good as exact from here on: verdicts look at shares of 0.005 and their like.
_ACCURACY = 1e-7
#: Logarithms of a stiffness or damping of zero, and below: no user is there.
_LEAST = np.finfo(np.float64).tiny
_SQRT_2PI = float(np.sqrt(2.0 * np.pi))
_STIFFNESS, _DAMPING = 0, 1


@dataclasses.dataclass(frozen=True, eq=False)
class Users:
    """Populations of users, one per draw (D,); stiffness first, damping second.

    The mean and the SD are those of the logarithms where `log` is true, else in N/m and N·s/m.
    """

    log: bool
    mean: Array  # (2, D)
    sd: Array  # (2, D)
    correlation: Array  # (D,)

    @classmethod
    def of(cls, mean: Array, covariance: Array, *, log: bool) -> Users:
        """Take means (D, 2) and covariances (D, 2, 2)."""
        variance = np.stack([covariance[:, 0, 0], covariance[:, 1, 1]])
        sd = np.sqrt(variance)
        return cls(log, mean.T, sd, covariance[:, 0, 1] / (sd[0] * sd[1]))

    @property
    def size(self) -> int:
        """Number of populations, D."""
        return self.correlation.size

    def select(self, which: NDArray[np.intp] | slice) -> Users:
        """Return some of the populations."""
        return Users(self.log, self.mean[:, which], self.sd[:, which], self.correlation[which])

    def column(self) -> Users:
        """Return the same with a last axis of one, which frequencies broadcast against."""
        return Users(self.log, self.mean[..., None], self.sd[..., None], self.correlation[:, None])

    def native(self, score: float, quantity: int) -> Array:
        """Return the stiffness (0) or damping (1) that lies `score` SDs from the mean, (D,)."""
        value = self.mean[quantity] + score * self.sd[quantity]
        return np.exp(value) if self.log else value

    def central_ranges(self, level: float) -> Boxes:
        """Return the limits between which the central `level` of stiffness and of damping lie."""
        edge = float(-special.ndtri(0.5 * (1.0 - level)))
        stiffness = self.native(-edge, _STIFFNESS), self.native(edge, _STIFFNESS)
        damping = self.native(-edge, _DAMPING), self.native(edge, _DAMPING)
        return Boxes.of(stiffness, damping)


class DiscIntegral(NamedTuple):
    """How the integral over a disc is taken."""

    inner: int  # 0 where stiffness has its law given damping, 1 the other way round
    nodes: int  # Over the other quantity


class _Axis(NamedTuple):
    """One quantity's part of the distance, gain·value + offset, and its law."""

    gain: Array
    offset: Array
    mean: Array
    sd: Array


@cache
def _nodes(count: int) -> tuple[Array, Array]:
    """Return places from -1 to 1 and weights; even in the angle, as a disc ends like a root."""
    places, weights = special.roots_legendre(count)
    angle = 0.5 * np.pi * places
    return np.sin(angle), 0.5 * np.pi * np.cos(angle) * weights


def share_within(
    users: Users, plane: DistancePlane, radius: Array, integral: DiscIntegral
) -> Array:
    """Return the share of each population with abs(Z_h) of at most `radius`, N·s/m.

    Fields of populations, plane and radius have shapes that broadcast; so has the result.
    """
    axes = (
        _Axis(-plane.per_rate, plane.imaginary, users.mean[0], users.sd[0]),
        _Axis(plane.gain, plane.real, users.mean[1], users.sd[1]),
    )
    inner = axes[integral.inner]
    outer = axes[1 - integral.inner]
    places, weights = _nodes(integral.nodes)
    first_end = _score(users.log, outer, (-radius - outer.offset) / outer.gain)
    second_end = _score(users.log, outer, (radius - outer.offset) / outer.gain)
    low = np.clip(np.minimum(first_end, second_end), -_FARTHEST, _FARTHEST)
    high = np.clip(np.maximum(first_end, second_end), -_FARTHEST, _FARTHEST)
    half = 0.5 * (high - low)
    score = 0.5 * (high + low)[..., None] + half[..., None] * places
    chord = _chord(users, outer, inner, score, radius)
    density = np.exp(-0.5 * score**2) / _SQRT_2PI
    return np.asarray(half * ((density * chord) @ weights))


def _chord(users: Users, outer: _Axis, inner: _Axis, score: Array, radius: Array) -> Array:
    """Return the probability of the inner quantity's chord through the disc at each outer score."""
    value = outer.mean[..., None] + outer.sd[..., None] * score
    if users.log:
        value = np.exp(value)
    across = outer.gain[..., None] * value + outer.offset[..., None]
    reach = radius[..., None]
    half_chord = np.sqrt(np.maximum((reach - across) * (reach + across), 0.0))
    gain = np.abs(inner.gain)[..., None]
    middle = -(inner.offset / inner.gain)[..., None]
    correlation = users.correlation[..., None]
    sd_given_outer = np.sqrt((1.0 - correlation) * (1.0 + correlation))
    column = _Axis(gain, inner.offset, inner.mean[..., None], inner.sd[..., None])
    mean_given_outer = correlation * score
    above = _score(users.log, column, middle + half_chord / gain) - mean_given_outer
    below = _score(users.log, column, middle - half_chord / gain) - mean_given_outer
    return special.ndtr(above / sd_given_outer) - special.ndtr(below / sd_given_outer)


def _score(log: bool, axis: _Axis, value: Array) -> Array:
    """Return how many SDs a stiffness or damping lies from the mean."""
    if log:
        value = np.log(np.maximum(value, _LEAST))
    return (value - axis.mean) / axis.sd


def choose_integral(
    users: Users, plane: DistancePlane, radius: Array, accuracy: float = _ACCURACY
) -> list[DiscIntegral]:
    """Return for each frequency (M,) the integral whose digits settle with the fewest nodes.

    A few populations (D, 1) are tried: which order is smooth depends on the frequency more than on
    the draw.
    """
    shape = np.broadcast_shapes(users.correlation.shape, radius.shape)
    fewest = np.full(shape[1], _NODE_COUNTS[-1])
    inner = np.zeros(shape[1], dtype=np.intp)
    for quantity in (_STIFFNESS, _DAMPING):
        open_at = np.arange(shape[1])
        shares = share_within(users, plane, radius, DiscIntegral(quantity, _NODE_COUNTS[0]))
        for nodes in _NODE_COUNTS[1:]:
            # More nodes than the other order needs are of no use.
            kept = nodes < fewest[open_at]
            open_at = open_at[kept]
            if not open_at.size:
                break
            there = plane.select(open_at)
            more = share_within(users, there, radius[open_at], DiscIntegral(quantity, nodes))
            settled = np.abs(more - shares[:, kept]).max(axis=0) < accuracy
            fewest[open_at[settled]] = nodes
            inner[open_at[settled]] = quantity
            open_at = open_at[~settled]
            shares = more[:, ~settled]
    return [DiscIntegral(int(i), int(n)) for i, n in zip(inner, fewest, strict=True)]
