"""Readers of logs: each turns a file or folder of one format into its tables."""
