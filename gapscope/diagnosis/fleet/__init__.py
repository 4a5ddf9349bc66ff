"""Several units of one type of arm: which effects they share, and which unit is which."""
