"""Plain methods beside the diagnosis: chance, one effect, forward selection, ridge, a classifier."""
