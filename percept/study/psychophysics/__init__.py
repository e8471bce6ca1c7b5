"""The psychophysics table, and whether biases are smaller than one JND; by both methods."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from percept.results import PsychophysicsRow, Skipped
from percept.study.data import Data
from percept.study.psychophysics.classical import absent_jnds, classical_psychophysics
from percept.study.psychophysics.equivalence import equivalence

if TYPE_CHECKING:
    from percept.study.fit import Fit

__all__ = ["equivalence", "psychophysics"]


def psychophysics(data: Data, fit: Fit | None) -> Iterator[PsychophysicsRow | Skipped]:
    """Yield points of equality, thresholds, spreads and reliability, in the scene's family."""
    yield from absent_jnds(data)
    if data.asked.method != "bayesian":
        yield from classical_psychophysics(data)
    if fit is not None:
        # The classical method does without the model.
        from percept.study.psychophysics.posterior import posterior_psychophysics

        yield from posterior_psychophysics(fit)
