"""The page and the table of an audit."""
