"""A learnt residual network as a page and on the terminal."""
