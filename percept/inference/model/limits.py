"""Limits of what a fit reports: intervals of cells, and contrasts.

Given draw s, a quantity's location is N(mean_s, sd_s²) and a user about it N(0, population_sd_s²).
So each kind of interval has limits that are roots of a mean over S draws of a normal law:

    mean    the location lies in it with the level's probability
    user    the location + a user lies in it with the level's probability
    share   it holds a share of all users with the confidence's probability
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.model.gaussian import Moments
from percept.inference.model.model import Model
from percept.inference.sampling.endpoints import mixture_limits, share_half_width
from percept.inference.sampling.gate import Estimates

Array = NDArray[np.float64]
#: What a limit is of: a quantity, and an environment or another place.
Name = tuple[str, str]

#: What an interval covers: the average user, the next user, a share of all users.
KINDS = ("mean", "user", "share")
#: Error of a score in SDs, at most: about a thousandth of the half-width of an interval at 99 %.
_SCORE_ACCURACY = 0.003


@dataclasses.dataclass(frozen=True, eq=False)
class Combinations:
    """Combinations of a model's locations, and the kinds of intervals that they have."""

    names: tuple[Name, ...]
    rows: Array  # (L, R) Weights
    kinds: tuple[str, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Limits:
    """Limits of a model's cells and of further combinations, all under one tolerance."""

    model: Model  # Whose locations they are
    _: dataclasses.KW_ONLY
    kinds: tuple[str, ...] = KINDS  # Of `KINDS`, for the cells
    level: float = 0.99  # Credibility of the intervals of the average user and of the next user
    share: float = 0.99  # The third kind holds this share of all users
    confidence: float = 0.95  # With this probability
    further: tuple[Combinations, ...] = ()  # Beside the cells

    @property
    def _groups(self) -> list[Combinations]:
        cells = Combinations(self.model.cells, self.model.cell_rows, self.kinds)
        return [cells, *self.further]

    def identity(self) -> tuple[object, ...]:
        """Return what beside the model decides the limits."""
        further = [dataclasses.astuple(group) for group in self.further]
        return ("limits", self.kinds, self.level, self.share, self.confidence, *further)

    def components(self, points: Array) -> Array:
        """Moments per draw of cells and further combinations, packed: shape (W, 3 L)."""
        rows = [group.rows for group in self._groups]
        return self.model.moments(points, np.vstack(rows)).pack()

    def of(
        self,
        kind: str,
        moments: Moments,
    ) -> tuple[Array, Array, Array]:
        """Lower and upper limits (L,) of one kind, and each draw's pull on them, (S, 2 L)."""
        if kind == "share":
            centre, half_width, influence = share_half_width(
                moments.mean,
                moments.sd,
                moments.population_sd,
                share=self.share,
                confidence=self.confidence,
            )
            return centre - half_width, centre + half_width, influence
        sd = moments.sd
        if kind == "user":
            sd = np.hypot(moments.sd, moments.population_sd)
        return mixture_limits(moments.mean, sd, 0.5 * (1.0 - self.level))

    def estimates(self, components: Array) -> Iterator[tuple[Estimates, Array]]:
        """Limits of one kind after another, with their influence; the scale is the half-width."""
        moments = Moments.unpack(components)
        first = 0
        for group in self._groups:
            last = first + len(group.names)
            of_group = moments.of(slice(first, last))
            for kind in group.kinds:
                lower, upper, influence = self.of(kind, of_group)
                lower_names = [_limit_name("lower", kind, name) for name in group.names]
                upper_names = [_limit_name("upper", kind, name) for name in group.names]
                estimates = Estimates(
                    names=(*lower_names, *upper_names),
                    value=np.concatenate([lower, upper]),
                    scale=np.tile(0.5 * (upper - lower), 2),
                )
                yield estimates, influence
            first = last


def _limit_name(
    end: str,
    kind: str,
    name: Name,
) -> str:
    """Name a limit in words, as messages show it."""
    quantity, where = name
    return f"{end} {kind} limit of {quantity} in {where}"


def limits_of(
    names: Sequence[str],
    values: Array,
    kind: str,
    wanted: Sequence[Name],
) -> tuple[Array, Array]:
    """Pick the limits of one kind, or what else belongs to them, by name.

    Parameters
    ----------
    names : sequence of str
        As `Limits.estimates` gives them.
    values : ndarray
        Of each name: limits, or their errors.
    kind : str
        Of `KINDS`.
    wanted : sequence of (str, str)
        The L cells or combinations.

    Returns
    -------
    lower, upper : ndarray
        Shape (L,) each.
    """
    by_name = dict(zip(names, values.tolist(), strict=True))
    lower = [by_name[_limit_name("lower", kind, name)] for name in wanted]
    upper = [by_name[_limit_name("upper", kind, name)] for name in wanted]
    return np.array(lower), np.array(upper)


def level_together(
    mean: Array,
    sd: Array,
    values: Array,
    level: float,
) -> float:
    """Search for the level of single limits that hold a whole family.

    A score s stands for limits of level 2 Phi(s) - 1, each quantity by itself. Joint draws tell how
    often some quantity lies outside its limits. The score searched for leaves out as many as a
    single interval would. It is at most Bonferroni's, which always suffices.

    Parameters
    ----------
    mean, sd : ndarray
        Normal laws of L quantities given S posterior draws, shape (S, L).
    values : ndarray
        Joint posterior draws of the quantities, shape (N, L).
    level : float
        Probability that all quantities lie within their limits.

    Returns
    -------
    float
        Of single limits, from `level` to the one that Bonferroni's inequality gives.
    """
    from scipy import optimize  # slow to import, and rarely needed

    outside = 1.0 - level
    of_one = _score(outside)
    of_bonferroni = _score(outside / values.shape[1])

    def excess(score: float) -> float:
        """Share of draws with a quantity outside, less what is allowed."""
        tail = float(special.ndtr(-score))
        lower, upper, _ = mixture_limits(mean, sd, tail)
        is_outside = (values < lower) | (values > upper)
        return float(is_outside.any(axis=1).mean()) - outside

    score = of_bonferroni
    # Noise of the draws may put the crossing beyond either end.
    if excess(of_one) <= 0.0:
        score = of_one
    elif excess(of_bonferroni) < 0.0:
        score = float(optimize.brentq(excess, of_one, of_bonferroni, xtol=_SCORE_ACCURACY))
    return 1.0 - 2.0 * float(special.ndtr(-score))


def _score(outside: float) -> float:
    """SDs of a normal beyond which a probability lies, half of it on either side."""
    return -float(special.ndtri(0.5 * outside))
