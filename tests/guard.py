"""The one limit of time that tests have."""

from __future__ import annotations

HANG = 600.0
"""A test that waits this long hangs [s]: a guard against that alone. No outcome depends on how busy a machine is."""
