"""A study: everything an analysis can give, evaluated on demand."""

from __future__ import annotations

from percept.study.study import Study

__all__ = ["Study"]
