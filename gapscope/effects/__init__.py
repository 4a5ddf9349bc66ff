"""The catalogue of effects: named physical causes of a gap, one file per family."""
