"""How much a device moves when the periods of its log are drawn again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from percept.identify.density import DeviceDensity
from percept.identify.fit import DeviceFit, climb
from percept.identify.spectra import Periods

__all__ = ["bootstrap_sds"]

Array = NDArray[np.float64]

#: Fewest different periods of a drawn log: two or one show too little noise to weigh lines by.
_FEWEST_DISTINCT = 3


def bootstrap_sds(
    fit: DeviceFit, periods: Periods, replicates: int, rng: np.random.Generator
) -> Array:
    """Return SDs of the log parameters over logs made of periods drawn with replacement.

    Parameters
    ----------
    fit : DeviceFit
        Of all periods.
    periods : Periods
        R of them.
    replicates : int
        Logs, two or more.
    rng : numpy.random.Generator
        Draws the periods.

    Returns
    -------
    ndarray, shape (d,)
        Times √(R/(R - 1)): drawn periods vary about the mean of R, not about the truth.
    """
    repeats = periods.force.shape[1]
    model = fit.density.model
    parameters = fit.density.parameters
    points: list[Array] = []
    while len(points) < replicates:
        which = rng.integers(repeats, size=(repeats,))
        if np.unique(which).size < _FEWEST_DISTINCT:
            continue
        drawn = DeviceDensity(model, periods.spectra(which), parameters)
        points.append(climb(drawn, fit.point).x)
    spread = np.std(points, axis=0, ddof=1)
    return np.asarray(spread * np.sqrt(repeats / (repeats - 1.0)))
