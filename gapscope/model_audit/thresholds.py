"""All thresholds of the audit, each with its meaning, its unit in brackets and where it comes from in parentheses.

``physical`` follows from what bodies and arms are made of; ``hand`` was set on the models named in
``experiments/35_audit.py`` as training, and is judged on the others.
"""

from __future__ import annotations

# fmt: off

# --- inertials
# Share by which the largest moment may exceed the sum of the others, for numbers of four digits [1]. (physical)
TRIANGLE_EXCESS = 2e-3
LEAST_MASS = 1e-3  # A link below is a frame with a dummy inertial, not a body [kg]. (physical)

POINT_MASS = 0.1  # Lighter parts may be points, as sensors and tools often are [kg]. (hand)
# Links lighter than this share of the robot hardly change its torque: what is odd about them is a note [1]. (hand)
LIGHT_SHARE = 0.005

# --- mass and moments against the shapes of the link
# Densest bodies are steel and copper, 7850 and 8960; beyond, shapes or mass are wrong [kg/m^3]. (physical)
LARGEST_DENSITY = 9000.0
# Mass over the volume of a closed casing; the lightest arms, of carbon and air, stay above [kg/m^3]. (hand)
LEAST_DENSITY = 100.0
# The homogeneous box of the same mass and moments is as dense as this at least; rods and frames are light [kg/m^3].
LEAST_BOX_DENSITY = 40.0  # (hand)
LARGEST_BOX_DENSITY = 20_000.0  # And at most: mass in the middle of a casing makes a small box [kg/m^3]. (hand)
# No body has a variance along an axis above (b - c)(c - a) for a hull from a to b and a centre c (Bhatia and Davis);
# lengths may be off by this share, since casings are drawn simplified [1]. (hand)
HULL_TOLERANCE = 0.25
# Moments are to be at least this share of those of a homogeneous body of the same shape [1]. (hand)
LEAST_MOMENT_SHARE = 0.1
# The centre of mass may lie outside the hull by this share of its largest edge [1]. (hand)
OUTSIDE = 0.15

# Products of inertia tell a sign if they are this share of the trace of the variance at least [1]. (hand)
SKEW = 0.05
OPPOSITE_PRODUCTS = -0.7  # Cosine between the products of body and shape below which they are opposite [1]. (hand)
OPPOSITE_LINKS = 2  # Fewest such links [1]. (hand)
OPPOSITE_SHARE = 0.75  # Share of the links that tell a sign [1]. (hand)

# --- inertials of neighbours
# By how much another assignment has to fit better, mean over links of the logarithm of the misfit [1]. (hand)
SHIFT_GAIN = 0.25
SHIFT_LINKS = 3  # Fewest links on which shifted inertials can be told [1]. (physical)
SHIFT_SHARE = 0.6  # Share of links that have to fit better [1]. (hand)
# Level of the F test by which masses alone are said to be shifted [1]. (statistics)
MASS_SHIFT_LEVEL = 0.02
# Healthy arms have moments per mass and size that differ by this at least: a smaller spread after a shift is what
# the arm had before it, standard deviation of the logarithm [1]. (hand)
MASS_SHIFT_SPREAD = 0.2

# --- placeholders
REPEATED_MOMENTS = 3  # So many links with the very same moments are a placeholder [1]. (hand)
SAME_ON_JOINTS = 4  # From so many joints on, the same value on all of them was not measured [1]. (hand)

# --- joints
AXIS_LENGTH = 1e-3  # Axes differ from length one by less, after rounding [1]. (physical)
STANDARD_GRAVITY = 9.80665  # [m/s^2]. (physical)
GRAVITY_TOLERANCE = 0.05  # On Earth gravity is within 0.3 % of it; rounding to 10 is 2 % [m/s^2]. (physical)

# --- static poses
REST_SPEED = 0.02  # A joint slower than this over a whole pose is at rest [rad/s]. (physical)
LEAST_POSE = 0.3  # Shortest rest that counts as a pose [s]. (hand)
LEAST_POSES = 5  # Fewest poses from which gravity torque is judged [1]. (hand)
GRAVITY_MISFIT = 0.1  # Gravity torque off by less than this share of its spread is as it should be [1]. (hand)
OPPOSITE = -0.5  # A joint's torque is of the other sign if it correlates with the model's below this [1]. (hand)
