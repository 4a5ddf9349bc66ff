"""The Gymnasium environment, whose effects can be switched on and off."""
