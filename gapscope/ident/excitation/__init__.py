"""Exciting trajectories: the motion within limits that determines the parameters best."""
