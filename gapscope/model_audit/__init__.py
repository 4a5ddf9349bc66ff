"""What is odd about a robot model, found in its file before any recording exists."""
