"""What the priors do to the intervals: the same posterior under priors a quarter wider."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.inference.hierarchy.density import ConditionalMoments
from percept.inference.hierarchy.models import IntervalEstimands, Pooled
from percept.inference.hierarchy.wider_priors import reweighted
from percept.scene import Scene
from percept.study.bayesian import Fit
from percept.study.posterior import thinned_points
from percept.study.streams import Stream, generator

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class PriorPull:
    """Limits under priors a quarter wider, beside those of the same draws under the priors themselves."""

    limits: dict[str, tuple[Array, Array]]
    own: dict[str, tuple[Array, Array]]
    effective: float  # Effective number of draws left after reweighting


def prior_pull(fit: Fit, scene: Scene) -> PriorPull | None:
    """Reweight the posterior to wider priors: SDs and scales by a quarter, correlations in proportion.

    The scales keep their draws, weighted by the ratio of priors and by the ratio of likelihoods with the
    locations integrated out; the locations are worked out anew under the wider priors.
    """
    model = fit.prepared.model
    if not isinstance(model, Pooled):
        return None
    points = thinned_points(fit)[0]
    log_weight, packed = reweighted(model.density, points)
    weight = special.softmax(log_weight)
    rng = generator(scene.inference.seed, Stream.PRIOR_PULL)
    wider = ConditionalMoments.unpack(packed[_systematic(weight, rng)])
    asked = scene.inference
    estimands = IntervalEstimands(
        model, kinds=asked.kinds, level=asked.level, share=asked.held_share, confidence=asked.confidence
    )
    limits, own = (
        {str(kind): estimands.limits(kind, laws)[:2] for kind in asked.kinds}
        for laws in (wider, model.laws(points))
    )
    return PriorPull(limits, own, float(1.0 / np.sum(weight**2)))


def _systematic(weight: Array, rng: np.random.Generator) -> NDArray[np.intp]:
    """Choose as many draws, each as often as its weight says, to within one."""
    places = (np.arange(weight.size) + rng.random()) / weight.size
    return np.minimum(np.searchsorted(np.cumsum(weight), places), weight.size - 1)
