"""Puts this folder on ``sys.path``, so that tests in its sub-folders import ``documents`` and ``synthetic``."""
