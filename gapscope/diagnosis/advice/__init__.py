"""The next recording: a motion on which explanations that are still open predict different torques."""
