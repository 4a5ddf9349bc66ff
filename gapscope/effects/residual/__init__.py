"""The residual network in use: what it says of a motion, by numpy alone; ``gapscope.ident.residual`` trains it."""
