"""A posterior under priors a quarter wider, by reweighting.

Where data say nothing of a scale, the weights of draws under normal priors c times as wide have a Pareto tail
of index 1 - 1/c²: .36 here. Twice as wide it would be .75, and a few draws would decide.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.inference.hierarchy.conditional import Conditional
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.scales import Scales

__all__ = ["reweighted", "wider", "with_priors"]

Array = NDArray[np.float64]
_WIDER = 1.25
_CHUNK = 512


def reweighted(density: CollapsedDensity, points: Array) -> tuple[Array, Array]:
    """Weigh draws of the scales to wider priors, and work out the locations anew under these.

    Parameters
    ----------
    density : CollapsedDensity
        The model.
    points : ndarray, shape (S, d)
        Draws of its posterior.

    Returns
    -------
    log_weight : ndarray, shape (S,)
        Log of the ratio of the posteriors, up to a constant: of priors, and of likelihoods with the locations
        integrated out.
    packed : ndarray, shape (S, 3 C)
        Laws of the cells under the wider priors, as `Laws.pack`.
    """
    priors = wider(density.priors)
    wide = with_priors(density, priors)
    log_weight, packed = [], []
    for start in range(0, len(points), _CHUNK):
        scales = density.layout.scales(np.ascontiguousarray(points[start : start + _CHUNK].T))
        change = wide.log_likelihood(scales) - density.log_likelihood(scales)
        log_weight.append(change + _prior_change(scales, density.priors, priors, trend=density.layout.trend))
        packed.append(Conditional(wide, scales).laws.pack())
    return np.concatenate(log_weight), np.concatenate(packed)


def wider(priors: Priors) -> Priors:
    """Widen SDs and scales of priors by a quarter, correlations in proportion."""
    scales = {
        field.name: _WIDER * getattr(priors, field.name)
        for field in dataclasses.fields(priors)
        if not field.name.endswith("_mean") and field.name != "rho_shape"
    }
    # Towards a flat law: the logarithm of every prior density is divided by the same number.
    return dataclasses.replace(priors, rho_shape=1.0 + (priors.rho_shape - 1.0) / _WIDER**2, **scales)


def with_priors(density: CollapsedDensity, priors: Priors) -> CollapsedDensity:
    """Build the same model under other priors of the locations; its scales are not its own."""
    return CollapsedDensity(density.statistics, priors, density.layout.options, density.resolution)


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
