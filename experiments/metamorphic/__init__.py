"""Cases written down otherwise, whose diagnosis has to be the same; ``experiments/53_metamorphic.py`` runs them."""
