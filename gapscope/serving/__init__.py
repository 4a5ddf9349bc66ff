"""An archive of diagnoses for a browser on the same machine, read-only."""
