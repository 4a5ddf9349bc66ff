"""The selection of effects by evidence."""
