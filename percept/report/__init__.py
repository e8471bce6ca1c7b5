"""The report of a study: page, report.json, tables, figures and posterior."""

from __future__ import annotations

from percept.report.document import build_document
from percept.report.write import write_fit, write_report
from percept.results.plain import dumps

__all__ = ["build_document", "dumps", "write_fit", "write_report"]
