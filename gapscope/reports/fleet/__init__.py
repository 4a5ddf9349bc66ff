"""A fleet as a page and in the terminal: what changed, which units are worst, what units share."""
