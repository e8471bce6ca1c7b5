"""What a magnitude costs: abs(Z_h) of many draws against one pass of np.hypot over the same array."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from percept.haptics import Device, perceived_magnitude


@dataclass(frozen=True)
class MagnitudeCost:
    """Run time and memory of abs(Z_h) over ω × environments × draws."""

    shape: tuple[int, int, int]  # (ω, environments, draws)
    seconds: float  # Best of the repeats, results written to an array made beforehand
    hypot_seconds: float  # The same for np.hypot of two full arrays
    ratio: float  # seconds/hypot_seconds
    scratch_bytes: int  # Largest memory held beside the arguments and the result
    result_bytes: int  # Size of the result


def magnitude_cost(
    *, omegas: int = 1000, environments: int = 5, draws: int = 10_000, repeats: int = 3, seed: int = 1
) -> MagnitudeCost:
    """Time `percept.haptics.perceived_magnitude` on random draws."""
    rng = np.random.default_rng(seed)
    omega = np.geomspace(0.1, 100, omegas)[:, None, None]
    stiffness = np.exp(rng.normal(np.log(1000), 0.3, (environments, draws)))
    damping = np.exp(rng.normal(0, 0.3, (environments, draws)))
    shape = (omegas, environments, draws)
    device, out = Device(1.0, 5.0), np.empty(shape)

    def magnitude() -> None:
        perceived_magnitude(omega, device, stiffness, damping, 1e-3, out=out)

    one, other = np.empty(shape), np.empty(shape)
    one[...], other[...] = stiffness, damping
    both = [(_seconds(magnitude), _seconds(lambda: np.hypot(one, other, out=out))) for _ in range(repeats)]
    seconds, hypot_seconds = (min(times) for times in zip(*both, strict=True))
    return MagnitudeCost(
        shape=shape,
        seconds=seconds,
        hypot_seconds=hypot_seconds,
        ratio=seconds / hypot_seconds,
        scratch_bytes=_peak_bytes(magnitude),
        result_bytes=out.nbytes,
    )


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _peak_bytes(run: Callable[[], Any]) -> int:
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
