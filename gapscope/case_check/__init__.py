"""Whether a case can be diagnosed, and what its recordings cannot tell, in seconds."""
