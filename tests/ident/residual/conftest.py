"""Training needs torch, the extra ``learn``: without it these tests are left out."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("torch") else ["test_*.py"]
