"""Many diagnoses: a table of all, and the effects of a unit over time."""
