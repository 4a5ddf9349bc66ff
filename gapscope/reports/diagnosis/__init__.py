"""The report: one HTML file that shows a diagnosis, offline."""

from gapscope.reports.diagnosis.page import render
from gapscope.reports.diagnosis.summary import SummaryRow, render_summary

__all__ = ["SummaryRow", "render", "render_summary"]
