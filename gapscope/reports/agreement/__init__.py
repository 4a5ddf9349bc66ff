"""The page and the table of an agreement."""
