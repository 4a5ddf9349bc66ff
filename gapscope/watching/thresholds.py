"""Numbers that decide when a watch raises an alarm, with unit, meaning and origin.

In parentheses where a value comes from, as in ``gapscope.diagnosis.thresholds``: physical, statistics, hand (set on
simulated arms of ``experiments/46_watch_alarms.py --training``, which its tables do not use), budget.
"""

from __future__ import annotations

import numpy as np

# fmt: off

# --- samples and blocks
BLOCK = 2.0  # Samples are gathered into blocks of this length [s]; an alarm comes at the end of one. (budget)
RATE = 100.0  # Motions are reduced to no less than this rate, twice Nyquist of the torque's band [Hz]. (budget)
FIRST = 10.0  # The cut-off of the positions is chosen on this much of the first motion [s]. (statistics)
LEAST_MOVING = 0.25  # A block in which no joint moves for this share of its samples says nothing [1]. (physical)
MOVING = 0.05  # A joint slower than this rests: dry friction may then take any value [rad/s]. (physical)

# --- learning: what is normal for this arm
LEAST_SEEN = 0.05  # A joint that moves for a smaller share of the motion to learn from is not watched [1]. (hand)
LEARN = 60.0  # Motion from which noise and friction level are learnt, without alarms [s]. (hand)
# Standard deviations of what may be wrong with the given arm from the start, and of a plausible change.
PRIOR_INERTIA = 0.3  # Of links, over their own parameters [1]. (physical)
PRIOR_TORQUE = 0.3  # Of friction, offset and rotors: torque over the joint's RMS torque [1]. (physical)
PRIOR_ANGLE = np.deg2rad(5.0)  # Of an encoder's zero [rad]. (physical)

# --- what may differ without being a change
# The model fits another motion with other values; standard deviations of that difference.
FORM_INERTIA = 0.01  # Of links, over their own parameters [1]. (hand)
FORM_FRICTION = 0.03  # Of friction, over the joint's friction torque [1]; as thresholds.FRICTION_FORM. (physical)
FORM_TORQUE = 0.005  # Of friction, offset and rotors, over the joint's RMS torque [1]. (hand)
FORM_ANGLE = np.deg2rad(0.1)  # Of an encoder's zero [rad]. (physical)
# Friction and offset wander, as they do when an arm warms up: over a minute by 3 %, over ten by 10 %.
WALK_FRICTION = 0.004  # Over the joint's friction torque, per square root of a second [1/sqrt(s)]. (physical)
WALK_HORIZON = 1800.0  # Everything else wanders by its FORM value in this time [s]. (hand)

# --- the test for a change between blocks
ONSETS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32)  # Blocks after the moments that are tried. (budget)
GUARD = 1  # Blocks before a moment that count neither before nor after: the change may lie in them. (hand)
CONFIRM = 3  # Blocks in a row that must exceed the threshold... (hand)
PERSISTS = 2  # ...and still do so without the first ones of them. (hand)
PATIENCE = 6  # Blocks at most that an alarm waits until one hypothesis stands out. (hand)
STANDS_OUT = 7.0  # The best hypothesis is likelier than the next by this much in ln of chance [1]. (hand)
RIGHT_MOMENT = 0.9  # The share it explains at the right moment, over the largest at any moment [1]. (hand)
NAMED_SURE = 4.0  # A named change is at least so many of its standard errors [1]. (hand)
NAMED_SHARE = 0.7  # A named change explains this share of what any change of the parameters would [1]. (hand)
USUAL_LEVELS = (0.5, 0.9)  # Quantiles of a statistic so far that widen it, beside chi-squared's [1]. (statistics)
USUAL_KEPT = 900  # Statistics from which these quantiles come: 30 min of motion. (budget)
USUAL_LEAST = 15  # Fewer say nothing of quantiles. (statistics)

# --- what no parameter explains
RISE = 3.0  # Noise power of a joint that is held for normal, over the learnt one [1]. (hand)
CUSUM_LIMIT = 5.0  # Sum of ln of the excess over that, block by block, that raises an alarm [1]. (hand)
CUSUM_STEP = 1.5  # No block adds more than this: a single push is no change [1]. (hand)

# --- slow drift
DRIFT_STEP = 0.25  # Friction that drifted by this share since it was learnt is noted, and each time again [1]. (hand)
DRIFT_SURE = 4.0  # In standard errors [1]. (statistics)

# --- time
USUAL_DELAY = 8  # Blocks without an alarm after which a statistic counts as usual. (hand)
LONGEST_REST = 3600.0  # Parameters wander for at most this long while nothing is recorded [s]. (physical)
UNKNOWN_REST = 60.0  # Time that is taken to lie between two recordings [s]: their clocks differ. (hand)
