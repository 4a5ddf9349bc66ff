"""The assessment of a selection on held-out data."""
