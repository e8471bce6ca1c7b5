"""What the priors do to the intervals: the same posterior under priors a quarter wider, by reweighting.

Where data say nothing of a scale, the weights of draws under normal priors c times as wide have a Pareto tail
of index 1 - 1/c²: .36 here. Twice as wide it would be .75, and a few draws would decide.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.hierarchy.conditional import Conditional
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.estimands import IntervalEstimands
from percept.inference.hierarchy.laws import Laws
from percept.inference.hierarchy.pooled import Pooled
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Options, Scales
from percept.scene import Scene
from percept.study.bayesian import Fit
from percept.study.posterior import thinned_points
from percept.study.streams import Stream, generator

__all__ = ["PriorPull", "prior_pull"]

Array = NDArray[np.float64]
_WIDER = 1.25
_CHUNK = 512


@dataclasses.dataclass(frozen=True, eq=False)
class PriorPull:
    """Limits under priors a quarter wider, beside those of the same draws under the priors themselves.

    Attributes
    ----------
    limits, own : dict of str to (ndarray, ndarray)
        By kind: lower and upper limits (C,) on the response scale, under wider priors and under the priors
        themselves. Both scatter alike, so that their difference hardly does.
    effective : float
        Effective number of draws left after reweighting; few, and the limits are rough.
    """

    limits: dict[str, tuple[Array, Array]]
    own: dict[str, tuple[Array, Array]]
    effective: float


def prior_pull(fit: Fit, scene: Scene) -> PriorPull | None:
    """Reweight the posterior to wider priors: SDs and scales by a quarter, correlations in proportion.

    The scales keep their draws, weighted by the ratio of priors and by the ratio of likelihoods with the
    locations integrated out; the locations are worked out anew under the wider priors.

    Parameters
    ----------
    fit : Fit
        A sampled posterior.
    scene : Scene
        Kinds, level, share, confidence and seed.

    Returns
    -------
    PriorPull or None
        None for models other than the pooled one of sessions.
    """
    model = fit.prepared.model
    if not isinstance(model, Pooled):
        return None
    points = thinned_points(fit)[0]
    log_weight, packed = _reweighted(model.density, points)
    weight = special.softmax(log_weight)
    rng = generator(scene.inference.seed, Stream.PRIOR_PULL)
    wider = Laws.unpack(packed[_systematic(weight, rng)])
    asked = scene.inference
    estimands = IntervalEstimands(
        model, kinds=asked.kinds, level=asked.level, share=asked.held_share, confidence=asked.confidence
    )
    limits, own = (
        {str(kind): estimands.limits(kind, laws)[:2] for kind in asked.kinds}
        for laws in (wider, model.laws(points))
    )
    return PriorPull(limits, own, float(1.0 / np.sum(weight**2)))


def _reweighted(old: CollapsedDensity, points: Array) -> tuple[Array, Array]:
    """Log weights (S,) of draws (S, d) under the wider priors, and their laws under these, packed."""
    priors = _relaxed(old.priors)
    wide = _with_priors(old, priors)
    log_weight, packed = [], []
    for start in range(0, len(points), _CHUNK):
        scales = old.layout.scales(np.ascontiguousarray(points[start : start + _CHUNK].T))
        change = wide.log_likelihood(scales) - old.log_likelihood(scales)
        log_weight.append(change + _prior_change(scales, old.priors, priors, trend=old.layout.trend))
        packed.append(Conditional(wide, scales).laws.pack())
    return np.concatenate(log_weight), np.concatenate(packed)


def _relaxed(priors: Priors) -> Priors:
    wider = {
        field.name: _WIDER * getattr(priors, field.name)
        for field in dataclasses.fields(priors)
        if not field.name.endswith("_mean") and field.name != "rho_shape"
    }
    # Towards a flat law: the logarithm of every prior density is divided by the same number.
    return dataclasses.replace(priors, rho_shape=1.0 + (priors.rho_shape - 1.0) / _WIDER**2, **wider)


def _with_priors(density: CollapsedDensity, priors: Priors) -> CollapsedDensity:
    """Build the same model under other priors of the locations; its scales are not its own."""
    layout = density.layout
    options = Options(
        subject_effect=layout.subject_effect, weber=layout.weber, common_spread=layout.common_spread
    )
    return CollapsedDensity(density.statistics, priors, options, density.resolution)


def _prior_change(scales: Scales, old: Priors, new: Priors, *, trend: bool) -> Array:
    """Give the logarithm of new over old prior density of the scales, up to a constant."""
    total = np.zeros(scales.log_prior.shape)
    half_normal = {"tau": "tau_scale", "sigma_u": "sigma_u_scale", "omega": "omega_scale"}
    half_normal["omega_e"] = "omega_e_scale"
    for name, scale in half_normal.items():
        if name in scales.named:
            total += _normal_change(scales.named[name], getattr(old, scale), getattr(new, scale))
    for suffix in ("", "_e"):
        mean, sd = f"log_s{suffix}_mean", f"log_s{suffix}_sd"
        level = scales.named.get(("s" if trend else "sigma") + suffix)
        if level is not None:
            off = np.log(level.reshape(-1, level.shape[-1])) - getattr(old, mean)
            total += _normal_change(off, getattr(old, sd), getattr(new, sd))
        if "kappa" + suffix in scales.named:
            sd = f"kappa{suffix}_sd"
            total += _normal_change(scales.named["kappa" + suffix], getattr(old, sd), getattr(new, sd))
    for name in ("rho_w", "rho_e", "rho_u"):
        if name in scales.named:
            rho = scales.named[name]
            total += (new.rho_shape - old.rho_shape) * np.log(np.maximum((1.0 - rho) * (1.0 + rho), 1e-300))
    return total


def _normal_change(values: Array, old: float, new: float) -> Array:
    return 0.5 * (values**2).sum(axis=0) * (1.0 / old**2 - 1.0 / new**2)


def _systematic(weight: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """Choose as many draws, each as often as its weight says, to within one."""
    places = (np.arange(weight.size) + rng.random()) / weight.size
    return np.minimum(np.searchsorted(np.cumsum(weight), places), weight.size - 1)
