"""Setup faults found in a case: what is wrong with the set-up, tested before any physics."""
