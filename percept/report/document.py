"""The document of a report: results as report.json holds them, with what the first screen says."""

from __future__ import annotations

from typing import Any

from percept.report.overview import findings
from percept.results import SCHEMA, Results, plain

__all__ = ["document_of"]


def document_of(results: Results) -> dict[str, Any]:
    """Return the plain values of report.json: every result, and the summary worked out from them.

    Parameters
    ----------
    results : Results
        Of a study, or of a report.json that was read back.

    Returns
    -------
    dict
        ``schema``, a key for each field of `percept.results.Results`, and ``summary``. JSON values
        only: infinities are text and NaN is None.
    """
    document: dict[str, Any] = {"schema": SCHEMA, **plain(results)}
    return document | {"summary": findings(document)}
