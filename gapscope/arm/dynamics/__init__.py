"""Rigid-body dynamics of an arm, the robot files that describe it, and roll-outs."""
