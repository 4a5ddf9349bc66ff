"""Agreement: which parameters of an arm are the same in several recordings, and with what a difference goes."""
