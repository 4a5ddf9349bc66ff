"""Joints of a robot file as a tree, and what becomes of those that are none of the arm's."""
