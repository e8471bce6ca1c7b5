"""A study: everything an analysis can give, computed on demand; and comparisons of two."""

from __future__ import annotations

from percept.results import Skipped
from percept.study.study import Study

__all__ = ["Skipped", "Study"]
