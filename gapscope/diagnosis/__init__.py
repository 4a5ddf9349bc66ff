"""From the gap to its cause: where it lies, which effect it is, how far it shrinks."""
