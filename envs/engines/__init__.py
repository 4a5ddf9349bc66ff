"""The engines that step the environment; only here is a physics engine imported."""
