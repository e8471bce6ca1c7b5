"""A study: everything an analysis can give, computed on demand; and comparisons of two."""

from __future__ import annotations

from percept.study.basics import Skipped
from percept.study.study import Study

__all__ = ["Skipped", "Study"]
