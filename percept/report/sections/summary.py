"""The summary: a few sentences to quote."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part

__all__ = ["build"]


def build(document: Mapping[str, Any]) -> Part:
    """Return the sentences of the summary.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    Part
    """
    return Part("summary", "Summary", {"data": document["data"], "coupling": document["coupling"]})
