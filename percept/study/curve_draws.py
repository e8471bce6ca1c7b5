"""Draws of (k, b) that curves go through: of the posterior, and of what stands behind classical intervals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from percept.boundary.draws import confidence_draws
from percept.errors import RefusalError
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.classical import FAMILIES
from percept.study.posterior import thinned_points
from percept.study.regions import Draws, displayable, subject_pairs
from percept.study.streams import Stream, generator

if TYPE_CHECKING:
    from percept.study.bayesian import Fit

# As many as there is information for: several conditional draws per effective draw of the scales ...
_POSTERIOR = 16_384
# ... and evenly spread ones, whose quantiles are as good as those of ten times as many independent ones.
_CLASSICAL = 8_192


def posterior_draws(fit: Fit, scene: Scene) -> Iterator[Draws]:
    """Draw the average and the next user of every environment, several times per kept set of scales."""
    points, _ = thinned_points(fit)
    repeats = max(1, round(_POSTERIOR / len(points)))
    rng = generator(scene.inference.seed, Stream.POSTERIOR_CURVES)
    drawn = fit.prepared.model.draw(np.repeat(points, repeats, axis=0), rng)
    column = {cell: c for c, cell in enumerate(fit.prepared.model.cells)}
    for kind, responses in zip(("mean", "user"), drawn, strict=True):
        if kind in scene.inference.kinds:
            native = displayable(fit.prepared.scale.native(responses))
            yield Draws(
                kind=kind,
                method="bayesian",
                family=scene.inference.family,
                level=scene.inference.level,
                pairs={
                    e: (native[:, column["k", e]], native[:, column["b", e]])
                    for e in dict.fromkeys(e for _, e in fit.prepared.model.cells)
                },
            )


def classical_draws(sessions: Sessions, scene: Scene) -> Iterator[Draws]:
    """Draw from the distributions behind the classical intervals, in both families."""
    rng = generator(scene.inference.seed, Stream.CLASSICAL_CURVES)
    for family in FAMILIES:
        values = subject_pairs(sessions, family)  # type: ignore[arg-type]
        for kind in ("mean", "user"):
            if kind not in scene.inference.kinds:
                continue
            pairs = {}
            for environment, (k, b) in values.items():
                try:
                    # Twice, so that the halves are independent and each is evenly spread.
                    halves = [
                        confidence_draws(
                            k,
                            b,
                            kind=kind,
                            family=family,  # type: ignore[arg-type]
                            draws=_CLASSICAL // 2,
                            rng=rng,
                        )
                        for _ in range(2)
                    ]
                except RefusalError:
                    continue
                drawn = np.concatenate(halves, axis=1)
                pairs[environment] = displayable(drawn[0]), displayable(drawn[1])
            yield Draws(
                kind=kind, method="classical", family=family, level=scene.inference.level, pairs=pairs
            )
