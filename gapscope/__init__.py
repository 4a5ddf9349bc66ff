"""The front door: the command line, and the few names that a user imports."""

from importlib.metadata import version

__version__ = version("gapscope")
