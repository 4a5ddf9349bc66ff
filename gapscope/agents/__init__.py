"""Feedforward controllers, training, and evaluation of agents by tracking reward."""
