"""The generator of blind cases: another simulator, with other laws; it imports nothing of the project but ``arm``."""
