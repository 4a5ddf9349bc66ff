"""Samples that no sensor took: spikes, and positions that were kept while the arm moved on."""
