"""Estimators of the parameters of a linear problem, one file each, with one interface (``estimate.Estimator``)."""
