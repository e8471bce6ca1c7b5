"""Boundaries of a study: from intervals (rectangles of k and b) and from posterior draws."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept import haptics
from percept.boundary.draws import pointwise_band, simultaneous_band
from percept.boundary.records import Boundary, Shape
from percept.haptics import AnyDevice, Coupling, Environment
from percept.study.cells import both_limits

__all__ = ["Bench", "draw_boundaries", "region_boundaries"]

Array = NDArray[np.float64]


class Bench:
    """Device, period and references that curves are drawn for, at given frequencies.

    Parameters
    ----------
    omega : ndarray, shape (M,)
        rad/s.
    device : Device or TabulatedDevice
        The device.
    period : float
        Sampling period, s.
    hold : str
        "average" (Eq. 8) or "true".
    references : dict of str to Environment
        Reference environments by name.
    coupling : Coupling or None
        The virtual coupling.
    """

    def __init__(
        self,
        omega: Array,
        device: AnyDevice,
        period: float,
        hold: str,
        references: dict[str, Environment],
        coupling: Coupling | None,
    ) -> None:
        self.omega, self.device, self.period, self.hold = omega, device, period, hold
        self.references, self.coupling = references, coupling
        self._curves: dict[tuple[str, bool], Array] = {}

    def curve(self, environment: str, *, coupled: bool) -> Array | None:
        """abs(Z_h) of a reference, N·s/m; None where a coupling is asked for and there is none."""
        if coupled and self.coupling is None:
            return None
        key = (environment, coupled)
        if key not in self._curves:
            self._curves[key] = np.abs(
                haptics.perceived_impedance(
                    self.omega,
                    self.device,
                    self.references[environment],
                    self.period,
                    coupling=self.coupling if coupled else None,
                    hold=self.hold,
                )
            )
        return self._curves[key]

    def boundary(
        self, environment: str, lower: Array, upper: Array, *, shape: Shape, level: float, **what: str
    ) -> Boundary:
        """Put curves together with the environment's reference and coupled curves."""
        reference = self.curve(environment, coupled=False)
        assert reference is not None
        return Boundary(
            environment=environment,
            shape=shape,
            level=level,
            omega=self.omega,
            lower=lower,
            upper=upper,
            reference=reference,
            coupled=self.curve(environment, coupled=True),
            **what,
        )


def region_boundaries(bench: Bench, intervals: pd.DataFrame) -> Iterator[Boundary]:
    """Corner and envelope curves of every rectangle of intervals.

    Parameters
    ----------
    bench : Bench
        Where the curves are drawn.
    intervals : DataFrame
        Rows of `Study.intervals` with both parameters.

    Yields
    ------
    Boundary
    """
    keys = ["environment", "kind", "method", "family", "joint"]
    for found, rows in intervals.groupby(keys, sort=False):
        limits = both_limits(rows)
        if limits is None:
            continue
        environment, kind, method, family, joint = (str(part) for part in found)
        level = float(rows["level"].iloc[0])
        for shape, curves in (("corner", haptics.corner_curves), ("envelope", haptics.magnitude_envelope)):
            lower, upper = curves(bench.omega, bench.device, *limits, bench.period, hold=bench.hold)
            yield bench.boundary(
                environment,
                lower,
                upper,
                shape=shape,  # type: ignore[arg-type]
                level=level,
                kind=kind,
                method=method,
                family=family,
                joint=joint,
            )


def draw_boundaries(
    bench: Bench, draws: dict[str, tuple[Array, Array]], *, kind: str, family: str, level: float
) -> Iterator[Boundary]:
    """Pointwise and simultaneous curves from draws of (k, b) per environment.

    Parameters
    ----------
    bench : Bench
        Where the curves are drawn.
    draws : dict of str to (ndarray, ndarray)
        Draws of k and b, each (N,), by environment.
    kind, family : str
        What the draws are.
    level : float
        Level of the curves.

    Yields
    ------
    Boundary
    """
    for environment, (stiffness, damping) in draws.items():
        for shape, band in (("pointwise", pointwise_band), ("simultaneous", simultaneous_band)):
            lower, upper = band(
                bench.omega, bench.device, stiffness, damping, bench.period, level=level, hold=bench.hold
            )
            yield bench.boundary(
                environment,
                lower,
                upper,
                shape=shape,  # type: ignore[arg-type]
                level=level,
                kind=kind,
                method="bayesian",
                family=family,
                joint="joint",
            )
