"""The report of an identification: one HTML file that opens offline."""

from gapscope.reports.identification.page import render

__all__ = ["render"]
