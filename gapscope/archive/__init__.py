"""Many diagnoses in one folder: found, read, dated, and put in order over time."""
