"""Pictures of a tracked arm, drawn from its kinematics: alike on every engine, with and without a display."""
