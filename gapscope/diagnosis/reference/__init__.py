"""What changed: the gap of a case against an arm that was identified on a reference."""
