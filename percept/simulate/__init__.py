"""Simulated studies: from the hierarchical model, and like a published table of limits.

Nothing here is measured, and every table made here says so in its column `source`.
"""

from __future__ import annotations

from percept.simulate.like import Correlations, realised_correlations, simulate_like, write_sessions

__all__ = ["Correlations", "realised_correlations", "simulate_like", "write_sessions"]
