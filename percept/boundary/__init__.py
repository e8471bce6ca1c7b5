"""Boundaries of perceived impedance, their bands and the law the bands follow."""

from __future__ import annotations

from percept.haptics import corner_curves, magnitude_envelope
from percept.results import Boundary

__all__ = ["Boundary", "corner_curves", "magnitude_envelope"]
