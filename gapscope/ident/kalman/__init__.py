"""Kalman filters over parameters and states, and when a parameter changed."""
