"""What is in a log: page, picture and terminal summary."""
