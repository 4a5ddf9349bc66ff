"""HTML pages and terminal tables of the results."""
