"""Commands that show results: a recording in 3D, and many diagnoses in a browser."""
