"""Laws by which a controller turns errors of the motion into torque; one file for each."""
