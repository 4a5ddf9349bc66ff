"""The page of an exciting trajectory."""
