"""The front door: the command line, the few names that a user imports, and the environment's name in Gymnasium."""

from importlib.metadata import version

from gapscope.envs.registration import register_environment

__version__ = version("gapscope")

register_environment()
