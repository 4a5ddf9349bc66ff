"""Intervals, identifiability and validation of identified parameters."""
