"""From conditioned signals to parameters: regressor, base parameters, excitation, estimators."""
