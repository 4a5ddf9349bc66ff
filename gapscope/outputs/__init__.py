"""Results as files: each function takes a result and a place, and returns the paths that it wrote."""
