"""The band against the environment's impedance: how wide, and by what law."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from percept.errors import RefusalError

__all__ = ["BandLaw", "BandStudy", "Estimate", "environment_magnitude_range", "power_law"]

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number with its interval."""

    value: float
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class BandLaw:
    """A law fitted to bands over environments.

    Attributes
    ----------
    method, kind, family : str
        Whose bands.
    model : str
        "power": band = w |Z|^p.
    parameters : dict of str to Estimate
        By name.
    level : float
        Of the parameters' intervals.
    sentence : str
        What the law says.
    """

    method: str
    kind: str
    family: str
    model: str
    parameters: dict[str, Estimate]
    level: float
    sentence: str


@dataclasses.dataclass(frozen=True, eq=False)
class BandStudy:
    """Bands of the device-free environment impedance at one frequency, and their laws.

    Attributes
    ----------
    omega : float
        rad/s.
    rows : DataFrame
        environment, method, kind, family, impedance (abs(Z_e) of the reference, N·s/m), lower, upper, band
        (N·s/m), relative (band over impedance).
    laws : tuple of BandLaw
        One per method, kind and family with at least three environments.
    """

    omega: float
    rows: pd.DataFrame
    laws: tuple[BandLaw, ...]


def environment_magnitude_range(
    omega: float, stiffness: tuple[float, float], damping: tuple[float, float]
) -> tuple[float, float]:
    """Smallest and largest abs(b - jk/omega) over a rectangle of (k, b).

    Parameters
    ----------
    omega : float
        rad/s.
    stiffness, damping : tuple of float
        Limits, N/m and N·s/m; may be negative.

    Returns
    -------
    lower, upper : float
        N·s/m.
    """
    axes = [(stiffness[0] / omega, stiffness[1] / omega), damping]
    near = [0.0 if low <= 0.0 <= high else min(abs(low), abs(high)) for low, high in axes]
    far = [max(abs(low), abs(high)) for low, high in axes]
    return math.hypot(*near), math.hypot(*far)


def power_law(method: str, kind: str, family: str, impedance: Array, band: Array, *, level: float) -> BandLaw:
    """Fit band = w |Z|^p by least squares on the logarithms.

    Parameters
    ----------
    method, kind, family : str
        Whose bands.
    impedance, band : ndarray, shape (J,)
        abs(Z_e) and band per environment, N·s/m, positive.
    level : float
        Confidence level of the parameters' t-intervals.

    Returns
    -------
    BandLaw

    Raises
    ------
    RefusalError
        With fewer than three environments.
    """
    count = impedance.size
    if count < 3:
        raise RefusalError(f"a law of the band needs three environments; there are {count}.")
    x, y = np.log(impedance), np.log(band)
    centred = x - x.mean()
    exponent = float(centred @ y / (centred @ centred))
    intercept = float(y.mean())
    residual = y - intercept - exponent * centred
    variance = float(residual @ residual) / (count - 2)
    reach = float(stats.t.isf(0.5 * (1.0 - level), count - 2))
    exponent_error = reach * math.sqrt(variance / float(centred @ centred))
    # The weight is the band at 1 N·s/m: extrapolated from the mean of log|Z|.
    at_one = intercept - exponent * float(x.mean())
    weight_error = reach * math.sqrt(
        variance * (1.0 / count + float(x.mean()) ** 2 / float(centred @ centred))
    )
    p = Estimate(exponent, exponent - exponent_error, exponent + exponent_error)
    w = Estimate(math.exp(at_one), math.exp(at_one - weight_error), math.exp(at_one + weight_error))
    return BandLaw(method, kind, family, "power", {"w": w, "p": p}, level, _sentence(p))


def _sentence(p: Estimate) -> str:
    if p.lower <= 1.0 <= p.upper:
        return (
            "The exponent's interval holds 1: a band proportional to the impedance (Weber's law) "
            "is not ruled out."
        )
    growing = "faster" if p.lower > 1.0 else "slower"
    return f"The band grows {growing} than the impedance: the exponent's interval does not hold 1."
