"""The residual network in use: what it says of a motion, by numpy alone; ``ident.residual`` trains it."""
