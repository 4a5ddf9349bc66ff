"""Training of the residual network, on what the corrected arm leaves of the torque; only training needs torch."""
