"""Single functions of SciPy and ArviZ, without importing all that stands beside them.

Importing that takes a twentieth of a report.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec, module_from_spec
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@contextmanager
def standing_in(modules: dict[str, Any]) -> Iterator[None]:
    """Let modules stand for others while something is imported; None is for one that is absent."""
    before = {name: sys.modules[name] for name in modules if name in sys.modules}
    sys.modules.update(modules)
    try:
        yield
    finally:
        for name in modules:
            del sys.modules[name]
        sys.modules.update(before)


class _Uncalled(ModuleType):
    """Stands for a module that is imported, and nothing of it called."""

    def __getattr__(self, name: str) -> None:
        return None


@cache
def array_stats() -> Any:
    """Return ArviZ's functions of arrays, as they come where xarray is not installed."""
    before = set(sys.modules)
    names = ("scipy.stats", "scipy.signal", "scipy.signal.windows")
    stand_ins: dict[str, Any] = {name: _Uncalled(name) for name in names}
    with standing_in(stand_ins | {"xarray": None, "arviz_base": None}):
        from arviz_stats.base import array_stats
    # Whoever imports ArviZ afterwards gets the whole of it.
    for name in sys.modules.keys() - before:
        if name.startswith("arviz_stats"):
            del sys.modules[name]
    return array_stats


def shapiro(values: Array) -> tuple[float, float]:
    """Test values (n,) by Shapiro and Wilk: W and p, as `scipy.stats.shapiro` gives them."""
    spec = find_spec("scipy.stats")
    assert spec is not None
    try:
        # Parts of a package are imported without it where an empty one stands for it.
        with standing_in({"scipy.stats": module_from_spec(spec)}):
            from scipy.stats._ansari_swilk_statistics import swilk
    except ImportError:
        # Another SciPy may have it elsewhere.
        from scipy import stats

        found = stats.shapiro(values)
        return found.statistic, found.pvalue
    middle = values.size // 2
    statistic, p_value, _ = swilk(np.sort(values) - values[middle], np.zeros(middle), False)
    return statistic, p_value
