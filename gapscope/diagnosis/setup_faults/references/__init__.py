"""Faults of references, velocities and control laws, found from the channels."""
