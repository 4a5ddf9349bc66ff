"""Exciting trajectories: which motion within limits tells the parameters best."""
