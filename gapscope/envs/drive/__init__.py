"""The drive physics that all engines share: from the commanded torque to the torque that moves the bodies."""
