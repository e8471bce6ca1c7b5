"""The report of results: page, report.json, tables, figures and posterior."""

from __future__ import annotations

from percept.report.write import (
    fill_fit,
    fill_report,
    fit_folder,
    report_folder,
    rewrite_report,
)

__all__ = ["fill_fit", "fill_report", "fit_folder", "report_folder", "rewrite_report"]
