"""A frequency response as one object: ω and complex values stored, everything else derived."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from percept.errors import UsageError
from percept.haptics._arrays import ComplexArray, FloatArray, complex_array, times
from percept.haptics._warp import warp


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """An impedance over ω.

    Parameters
    ----------
    omega : array_like
        rad/s, up to π/T in magnitude.
    value : array_like of complex
        N·s/m; its shape and ω's broadcast.
    period : float
        Sampling period T, s.

    Raises
    ------
    UsageError
        ω above Nyquist, T not positive, NaN among the values, or shapes that do not broadcast.
    """

    omega: FloatArray
    value: ComplexArray
    period: float

    def __post_init__(self) -> None:
        grid = warp(self.omega, self.period)
        value = complex_array(self.value, "FrequencyResponse value")
        try:
            np.broadcast_shapes(grid.omega.shape, value.shape)
        except ValueError:
            raise UsageError(
                "FrequencyResponse omega and value do not broadcast.", value=(grid.omega.shape, value.shape)
            ) from None
        grid.omega.flags.writeable = False
        object.__setattr__(self, "omega", grid.omega)
        object.__setattr__(self, "value", value)
        object.__setattr__(self, "period", grid.period)

    @property
    def magnitude(self) -> FloatArray:
        """abs(Z), N·s/m."""
        return np.hypot(self.value.real, self.value.imag)

    @property
    def phase(self) -> FloatArray:
        """Angle of Z, rad, −π to π."""
        return np.angle(self.value)

    @property
    def damping(self) -> FloatArray:
        """Effective damping Re Z, N·s/m."""
        return self.value.real

    @property
    def stiffness(self) -> FloatArray:
        """Effective stiffness −Ω·Im Z, N/m, with Ω = (2/T)·tan(ωT/2).

        Only its limit is lost where Ω is 0 or infinite: it is 0 where Im Z·Ω reads 0·inf.
        """
        return -times(self.value.imag, warp(self.omega, self.period).rate)
