"""Signal conditioning, samples, and effective sample sizes."""
