"""Environments whose references allow curves, and a band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

#: By parameter and environment, N/m or N·s/m; NaN where there is none.
References = Mapping[tuple[str, str], float]
#: Environments that laws of the band need.
FEWEST = 3


def placed(reference: References, parameters: Sequence[str], environments: Sequence[str]) -> tuple[str, ...]:
    """Return the environments with a reference of every parameter."""
    return tuple(e for e in environments if all(np.isfinite(reference[p, e]) for p in parameters))


def banded(reference: References, environments: Sequence[str], omega: float) -> tuple[str, ...]:
    """Return the environments whose band can be set against their impedance at `omega`: one above zero."""
    return tuple(e for e in environments if np.hypot(reference["b", e], reference["k", e] / omega) > 0)
