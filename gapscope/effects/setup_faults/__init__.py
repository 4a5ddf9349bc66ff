"""Setup faults, as they are made in recordings."""
