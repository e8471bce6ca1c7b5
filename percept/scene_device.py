"""The scene's device, its loop and its coupling: tables of TOML."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from percept.sessions.options import in_range
from percept.sessions.quantities import Table

# Strict: a quoted number, or true for 1, is a slip.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True), AfterValidator(in_range)]
NonNegative = Annotated[
    float, Field(ge=0, allow_inf_nan=False, strict=True), AfterValidator(in_range)
]
#: Samples; a loop so late renders nothing.
_LONGEST_DELAY = 1000.0


class ModeTable(Table):
    """A flexible mode of the device: a mass on a spring and a damper.

    Attributes
    ----------
    mass : float
        In kg.
    stiffness : float
        In N/m.
    damping : float
        In N·s/m.
    """

    mass: Positive
    stiffness: NonNegative
    damping: NonNegative = 0.0


class DevicePosteriorTable(Table):
    """What is not known of the device: a normal law of logarithms, or draws.

    Attributes
    ----------
    parameters : tuple of str
        `mass`, `damping`, `stiffness`, and `mode 1 mass`, `mode 1 stiffness`, `mode 1 damping` and
        so on.
    covariance : list of lists
        Of the logarithms of these parameters, about the logarithms of the values in `[device]`.
    draws : str
        Instead: a CSV with a column per parameter, in SI units, from the folder of the scene's
        file.
    """

    parameters: tuple[str, ...] = ("mass", "damping")
    covariance: tuple[tuple[float, ...], ...] | None = None
    draws: str | None = None

    @model_validator(mode="after")
    def _a_law(self) -> Self:
        if (self.covariance is None) == (self.draws is None):
            raise ValueError("give covariance or draws, one of them")
        if self.covariance is None:
            return self
        count = len(self.parameters)
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise ValueError(f"covariance must have {count} rows and columns, as parameters")
        matrix = np.array(self.covariance)
        # Written with fewer digits a covariance is symmetric to these.
        if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0):
            raise ValueError("covariance must be symmetric")
        if not np.linalg.eigvalsh(matrix)[0] > 0.0:
            raise ValueError("covariance must be positive definite")
        return self


class VelocityFilterTable(Table):
    """The low pass that a measured velocity goes through before a damper acts on it.

    Attributes
    ----------
    cutoff : float
        In rad/s, below the Nyquist frequency.
    order : int
        Of Butterworth's filter.
    """

    cutoff: Positive
    order: Annotated[int, Field(ge=1, le=8, strict=True)] = 1


class DeviceTable(Table):
    """The haptic device: mass (kg), damping (N·s/m), a spring and modes, or a measured response.

    `response` names a CSV with columns omega (rad/s), real and imaginary (N·s/m), from the folder
    of the scene's file. `response_floor` is the least real part above its end, N·s/m. `period` is
    in s.
    """

    mass: NonNegative | None = None
    damping: NonNegative | None = None
    stiffness: NonNegative = 0.0
    modes: tuple[ModeTable, ...] = ()
    response: str | None = None
    response_floor: Positive | None = None
    period: Positive
    hold: Literal["average", "true"] = "average"
    delay: NonNegative | None = None
    delay_seconds: NonNegative | None = None
    velocity_filter: VelocityFilterTable | None = None
    posterior: DevicePosteriorTable | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.response is None and (self.mass is None or self.damping is None):
            raise ValueError("give mass and damping, or response")
        if self.response is None and self.response_floor is not None:
            raise ValueError("response_floor belongs to a measured response")
        if self.response is not None and not (
            self.mass is None and self.damping is None and not self.modes and not self.stiffness
        ):
            raise ValueError(
                "a measured response holds mass, damping, stiffness and modes:"
                " give one or the other"
            )
        if self.posterior is not None:
            self._require_parameters(self.posterior)
        if self.delay is not None and self.delay_seconds is not None:
            raise ValueError("give delay in samples or delay_seconds, not both")
        if self.delay_in_samples > _LONGEST_DELAY:
            raise ValueError(
                f"a delay of {self.delay_in_samples:g} samples is above {_LONGEST_DELAY:g}:"
                " delay counts samples, delay_seconds is in s"
            )
        wanted = self.velocity_filter
        if wanted is not None and not wanted.cutoff * self.period < math.pi:
            raise ValueError(
                f"velocity_filter.cutoff, {wanted.cutoff:g} rad/s, must lie below the Nyquist"
                f" frequency, {math.pi / self.period:.6g} rad/s"
            )
        return self

    def _require_parameters(self, posterior: DevicePosteriorTable) -> None:
        """Refuse a posterior of what the device does not have."""
        if self.response is not None:
            raise ValueError("a measured response has no posterior")
        values = self.parameters
        for name in posterior.parameters:
            if name not in values:
                known = ", ".join(values)
                raise ValueError(f"posterior names {name!r}; the device has {known}")
            if posterior.covariance is not None and not values[name]:
                raise ValueError(f"{name} is zero, which has no logarithm")

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters by the names that a posterior gives them; empty for a measured response."""
        if self.mass is None or self.damping is None:
            return {}
        values = {"mass": self.mass, "damping": self.damping, "stiffness": self.stiffness}
        for number, mode in enumerate(self.modes, start=1):
            for name, value in mode:
                values[f"mode {number} {name}"] = value
        return values

    @property
    def delay_in_samples(self) -> float:
        """Delay of the loop, in sampling periods; 0 without one."""
        if self.delay_seconds is not None:
            return self.delay_seconds / self.period
        return self.delay or 0.0


class CouplingTable(Table):
    """The virtual coupling: stiffness (N/m) and damping (N·s/m)."""

    stiffness: Positive
    damping: NonNegative
