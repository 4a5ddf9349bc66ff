"""Files that an identification writes."""
