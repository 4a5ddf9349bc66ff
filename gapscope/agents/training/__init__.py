"""Agents that act on top of a model's feedforward: trained in the simulator made from it, tried on a hidden arm."""
