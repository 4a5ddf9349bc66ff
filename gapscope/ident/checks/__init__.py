"""Checks of recordings and fits, each with a remedy."""
