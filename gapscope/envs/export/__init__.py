"""The corrected arm as a file for other simulators."""
