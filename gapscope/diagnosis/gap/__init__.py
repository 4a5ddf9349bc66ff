"""The torque gap between a nominal arm and its recordings."""
