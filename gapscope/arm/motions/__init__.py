"""Reference motions, and motions given by samples."""
