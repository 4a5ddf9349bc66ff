"""What is in a log, before anything is known of it: columns, units, joints, and what the torque can be."""
