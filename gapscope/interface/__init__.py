"""The Python interface: one file per function, results that can be saved, read and shown in a notebook."""
