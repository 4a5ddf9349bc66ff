"""Many cases, units, days: their list, the runner, the rows of their diagnoses, and what these say together."""
