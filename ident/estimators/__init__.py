"""Estimators of the parameters of a linear problem, one file each, one interface (``ident.estimate.Estimator``)."""
