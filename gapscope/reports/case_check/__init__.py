"""The table of the check of a case."""
