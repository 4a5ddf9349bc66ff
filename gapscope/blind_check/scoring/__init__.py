"""The scorer of the blind check: what it counts, against what, and how it is shown."""
