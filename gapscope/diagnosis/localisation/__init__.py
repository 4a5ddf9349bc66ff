"""Where a gap lies, in depth: a readable rule, intervals of time, lines and bands of frequency."""
