"""The report of results: page, report.json, tables, figures and posterior."""

from __future__ import annotations

from percept.report.write import fill_report, report_folder, rewrite_report

__all__ = ["fill_report", "report_folder", "rewrite_report"]
