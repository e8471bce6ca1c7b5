"""emcee without scipy.stats, which takes longer to import than all else that sampling needs.

emcee takes `gaussian_kde` from scipy.stats while it is imported, for a move that is not used here. It finds a
stand-in that loads scipy.stats when it is called: emcee's KDE move works as ever, for whoever else uses emcee
in this process.
"""

from __future__ import annotations

import importlib
import sys
import types
from typing import Any

__all__ = ["emcee"]

_STATS = "scipy.stats"


def _load(name: str) -> Any:
    """Look up in the real module what the stand-in was not given, but for what imports ask of any module."""
    if name.startswith("__"):
        raise AttributeError(name)
    if sys.modules.get(_STATS) is _stand_in:
        del sys.modules[_STATS]
    return getattr(importlib.import_module(_STATS), name)


def _gaussian_kde(*arguments: Any, **settings: Any) -> Any:
    return _load("gaussian_kde")(*arguments, **settings)


_stand_in = types.ModuleType(_STATS)
vars(_stand_in).update(gaussian_kde=_gaussian_kde, __getattr__=_load)
sys.modules.setdefault(_STATS, _stand_in)
try:
    import emcee
finally:
    if sys.modules.get(_STATS) is _stand_in:
        del sys.modules[_STATS]
