"""The report: one HTML file that shows a diagnosis, offline."""

from diagnosis.report.page import render
from diagnosis.report.summary import SummaryRow, render_summary

__all__ = ["SummaryRow", "render", "render_summary"]
