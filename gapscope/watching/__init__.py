"""A recording, a folder or a bag followed while it grows: alarms that name what changed on the arm."""
