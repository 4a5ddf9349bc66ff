"""Commands over many cases."""
