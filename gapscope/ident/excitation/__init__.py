"""Exciting trajectories: the motion within limits that identifies the parameters best."""
