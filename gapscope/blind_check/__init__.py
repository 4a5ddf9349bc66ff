"""The blind check: cases whose effect is withheld, verdicts on them, then the labels opened and scored."""
