"""``python -m gapscope`` runs the command line."""

from gapscope.cli import main

main()
