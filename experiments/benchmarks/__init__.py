"""What the project costs, beside tools that others use; ``python -m experiments.benchmarks`` measures and tabulates.

A part is a module with ``points(settings)``: what it measures, each a ``Point``, whose rows are stored as soon as it is
measured. ``PARTS`` of ``parts.py`` lists them.
"""
