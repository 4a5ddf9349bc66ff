"""Files in and out: cases, import sections, tables, ROS bags."""
