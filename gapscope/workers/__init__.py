"""Calls of one function that run side by side: on this machine's processes, or on a cluster."""
