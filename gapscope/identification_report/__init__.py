"""The report of an identification: one HTML file that opens offline."""

from gapscope.identification_report.page import render

__all__ = ["render"]
