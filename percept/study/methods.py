"""Classical against Bayesian intervals of equal family and kind, with the reasons in numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from percept.inference.hierarchy.density import ConditionalMoments
from percept.inference.hierarchy.models import Pooled
from percept.inference.hierarchy.wider_priors import reweighted
from percept.scene import InferenceTable
from percept.study.basics import Array, Stream, generator
from percept.study.fit import Fit, estimands_of
from percept.study.intervals import Cell, known_moments

_KEYS = ["environment", "parameter", "kind", "family"]
_METHODS = ("classical", "bayesian")


def compare_intervals(
    intervals: pd.DataFrame, fit: Fit, asked: InferenceTable, cells: Sequence[Cell]
) -> pd.DataFrame:
    """Pair the methods' marginal intervals and say why they differ; cells are those of the scene's family."""
    marginal = intervals[intervals["joint"] == "marginal"]
    pair = [
        marginal.loc[marginal["method"] == method, [*_KEYS, "lower", "upper", "estimate"]]
        for method in _METHODS
    ]
    both = pair[0].merge(pair[1], on=_KEYS, suffixes=("_classical", "_bayesian"))
    if both.empty:
        return both
    native = {m: both[f"upper_{m}"] - both[f"lower_{m}"] for m in _METHODS}
    both["width_ratio"] = native["bayesian"] / native["classical"]
    both["shift"] = both["estimate_bayesian"] / both["estimate_classical"] - 1.0
    log = asked.family == "lognormal"
    lower, upper = (
        {m: _scaled(both[f"{side}_{m}"].to_numpy(), log) for m in _METHODS} for side in ("lower", "upper")
    )
    shared = np.minimum(*upper.values()) - np.maximum(*lower.values())
    both["overlap"] = np.maximum(shared, 0.0) / (np.maximum(*upper.values()) - np.minimum(*lower.values()))
    width = {m: upper[m] - lower[m] for m in _METHODS}
    centre = {m: 0.5 * (upper[m] + lower[m]) for m in _METHODS}
    at = list(zip(both["parameter"], both["environment"], strict=True))
    column, moments = [fit.column[cell] for cell in at], known_moments(cells, asked.family)
    sd = np.array([float(moments[cell].sd) for cell in at])
    typical = np.exp(np.log(fit.moments.population_sd).mean(axis=0))
    both["spread_ratio"] = (typical * fit.scale.unit)[column] / sd
    both["certainty_ratio"] = width["bayesian"] / width["classical"] / both["spread_ratio"]
    both["shift_sds"] = (centre["bayesian"] - centre["classical"]) / sd
    pull = prior_pull(fit, asked)
    if pull is not None:
        for s, side in enumerate(("lower", "upper")):
            own, wider = (
                {kind: _scaled(fit.scale.native(ends[s]), log) for kind, ends in limits.items()}
                for limits in (pull.own, pull.limits)
            )
            moved = np.array(
                [own[kind][c] - wider[kind][c] for kind, c in zip(both["kind"], column, strict=True)]
            )
            both[f"prior_{side}"] = moved / (0.5 * width["bayesian"])
        both["prior_effective"] = pull.effective
    of_other = marginal[(marginal["method"] == "classical") & (marginal["family"] != asked.family)]
    keys = ["environment", "parameter", "kind"]
    other = (of_other["upper"] - of_other["lower"]).set_axis(pd.MultiIndex.from_frame(of_other[keys]))
    wanted = pd.MultiIndex.from_frame(both[keys])
    both["scale_ratio"] = other.reindex(wanted).to_numpy() / native["classical"].to_numpy()
    for method in _METHODS:
        widths = pd.Series(width[method], wanted)
        mean = [(environment, parameter, "mean") for environment, parameter, _ in wanted]
        both[f"to_mean_{method}"] = widths.to_numpy() / widths.reindex(mean).to_numpy()
    return both


def _scaled(values: Array, log: bool) -> Array:
    return np.log(values) if log else values


@dataclasses.dataclass(frozen=True, eq=False)
class PriorPull:
    """Limits under priors a quarter wider, beside those of the same draws under the priors themselves."""

    limits: dict[str, tuple[Array, Array]]  # By kind: lower and upper, on the response scale
    own: dict[str, tuple[Array, Array]]
    effective: float  # Effective number of draws left after reweighting


def prior_pull(fit: Fit, asked: InferenceTable) -> PriorPull | None:
    """Reweight the posterior to wider priors: SDs and scales by a quarter, correlations in proportion.

    The scales keep their draws, weighted by the ratio of priors and by the ratio of likelihoods with the
    locations integrated out; the locations follow from the wider priors. None without such priors.
    """
    model = fit.model
    if not isinstance(model, Pooled):
        return None
    log_weight, packed = reweighted(model.density, fit.points)
    weight = special.softmax(log_weight)
    wider = ConditionalMoments.unpack(packed[_systematic(weight, generator(asked.seed, Stream.PRIOR_PULL))])
    estimands = estimands_of(model, asked)
    limits, own = (
        {str(kind): estimands.limits(kind, laws)[:2] for kind in asked.kinds}
        for laws in (wider, model.laws(fit.points))
    )
    return PriorPull(limits, own, float(1.0 / np.sum(weight**2)))


def _systematic(weight: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """Choose as many draws, each as often as its weight says, to within one."""
    points = (np.arange(weight.size) + rng.random()) / weight.size
    return np.minimum(np.searchsorted(np.cumsum(weight), points), weight.size - 1)
