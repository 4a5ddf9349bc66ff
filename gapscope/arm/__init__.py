"""The two inputs of everything: the nominal arm, recordings of it, and cases that hold both."""
