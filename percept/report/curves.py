"""The boundaries a document holds beside the whole range: close views, and values at one frequency."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from percept.report.plain import plain
from percept.report.select import EACH_BY_ITSELF

if TYPE_CHECKING:
    from percept.boundary.records import Boundary
    from percept.scene import Scene
    from percept.study import Study

# How closely the paper looks.
_LOOK_BY = 0.02
_POINTS = 61


def zoom_windows(scene: Scene, environments: list[str]) -> dict[str, list[float]]:
    """Return the window of ω that each environment's close view shows."""
    middle = scene.frequency.read_at
    usual = (middle * (1 - _LOOK_BY), middle * (1 + _LOOK_BY))
    windows = {}
    for environment in environments:
        low, high = scene.report.zoom.get(environment, usual)
        low, high = max(low, scene.frequency.lower), min(high, scene.frequency.upper)
        if low < high:
            windows[environment] = [float(low), float(high)]
    return windows


def close_views(study: Study, windows: Mapping[str, list[float]]) -> list[dict[str, Any]]:
    """Evaluate the boundaries of the average user anew in each window."""
    found: list[Boundary] = []
    for environment, window in windows.items():
        found += study.boundaries_at(
            np.linspace(window[0], window[1], _POINTS),
            (environment,),
            kinds=study.scene.inference.kinds[:1],
            joints=EACH_BY_ITSELF,
        )
    return [plain(record) for record in found]


def readings(study: Study) -> list[dict[str, Any]]:
    """Evaluate every boundary at one frequency: 10 rad/s, or the middle of a range without it."""
    omega = np.array([study.scene.frequency.read_at])
    return [plain(record) for record in study.boundaries_at(omega, joints=EACH_BY_ITSELF)]
