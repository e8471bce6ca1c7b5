"""A study: everything an analysis can give, evaluated on demand; and what can be made of one or two."""

from __future__ import annotations

from percept.study.basics import Skipped
from percept.study.study import Study

__all__ = ["Skipped", "Study"]
