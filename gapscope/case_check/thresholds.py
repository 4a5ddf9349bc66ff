"""All thresholds of the check of a case, each with its meaning, its unit in brackets and its origin in parentheses.

``physical`` follows from what arms, drives and logs are; ``hand`` was set by hand, and only decides about a remark.
"""

from __future__ import annotations

# fmt: off

# --- recordings
SLOW_RATE = 100.0  # Below, delays, elasticity and ripple are hardly seen [Hz]. (physical)
SHORT_DURATION = 10.0  # Seconds of motion in all, below which little can be told apart [s]. (hand)
STAMP_JITTER = 0.05  # Standard deviation of the steps of time over their median [1]. (hand)
VELOCITY_GAIN = 0.1  # A recorded velocity differs from that of the positions by less than this share [1]. (hand)
REFERENCE_ERROR = 0.5  # A reference follows the position to this share of the joint's range at least [1]. (hand)
SAME = 1e-9  # Series that differ by less are the same [rad or N m]. (physical)

# --- motion; of sliding joints in what counts as a radian
FOLLOWED = 0.1  # A joint that moves less may be held off its reference by its load [rad]. (hand)
STILL = 0.01  # A joint that moves less than this does not move [rad]. (physical)
SLIDING = 0.02  # Below this speed dry friction is not fully developed [rad/s]. (physical)
# Cosine between speed and its sign, of sliding samples: at one speed it is 1, evenly spread speeds have 0.87 [1].
ONE_SPEED = 0.97  # (hand)
FEW_REVERSALS = 4  # Reversals of a joint in all recordings [1]. (hand)
ONE_WAY = 0.05  # Share of sliding samples that each direction has at least [1]. (hand)
# Gravity torque of the nominal arm over the recordings, as share of what random postures give [1]. (hand)
GRAVITY_SHARE = 0.1
LEAST_GRAVITY = 0.1  # Gravity torque below this is none [N m]. (physical)
LEFT_OVER = 0.03  # Share of its torque that a healthy joint leaves, mostly the form of friction [1]. (physical)
INDEPENDENT = 0.1  # Share of the samples that are independent: a motion of 3 Hz at 60 samples a second [1]. (physical)
LEAST_LOAD = 0.01  # Joints with less than this share of the largest nominal torque count as loaded so [1]. (hand)
KNOWN = 0.5  # A base parameter is excited if its standard deviation is below this share of its size [1]. (hand)
FEW_EXCITED = 0.75  # Share of base parameters that should be excited [1]. (hand)

# --- torque
AT_LIMIT = 0.01  # Share of samples at the torque limit from which it is said [1]. (hand)

# --- amount of data
SECONDS = 30.0  # Of each recording is looked at for excitation and torque [s]. (budget)
RATE = 60.0  # Samples of these per second [Hz]. (budget)
