"""All thresholds that decide, priors, and budgets of a diagnosis, by stage.

Each states its meaning, its unit in brackets, and in parentheses where the value comes from:

    hand        set by hand on training cases: sets of the blind check's generator, sample cases, synthetic arms
    physical    known of arms, drives and logs in general
    statistics  follows from a false-alarm rate, or from how many independent samples there are
    definition  part of what ``diagnosis.json`` promises
    budget      as much as computing time allows; more would hardly change a diagnosis

Array layouts, grids of plots, texts and tolerances of rounding stay in their modules. The blind check freezes these
values (``gapscope/blind_check/check.py``).
"""

from __future__ import annotations

import numpy as np

from gapscope.model.conditioning import MIN_CUTOFF, TORQUE_CUTOFF, TRIM
from gapscope.model.design import LIKELY
from gapscope.model.equations import MIN_NOISE
from gapscope.model.readings import ORDINARY_ERROR

# fmt: off

# --- gap: what is used of recordings
STICKING_SPEED = 0.02  # A joint that is slower all the time is called still [rad/s]. (physical)
# A recording is used up to a change during it if that lasts this long [s]. (hand)
MIN_UNCHANGED = 3.0
# Share of its torque by which a law in nature differs from the catalogue's form: of an effect, and of the dry friction
# of a healthy arm, from c sgn v, when it slides [1]. (hand)
EFFECT_FORM = FRICTION_FORM = 0.03


# --- gap: long recordings
# Recordings longer than this in all are looked at in windows [s]... (budget)
LONG_RECORDINGS = 300.0
EXAMINED = 180.0  # ...of this length in all [s]... (budget)
WINDOW = 10.0  # ...and of about this length each [s], a period of most exciting motions... (hand)
MIN_WINDOW = 4.0  # ...or of many recordings no less than this [s]. (hand)
SHORT_MOTION = 2 * WINDOW  # Less in all than two motions last is little: a note says so [s].

# --- gap: recordings that hold what no arm can have
LARGEST_POSITION = 1e5  # Degrees of a motor behind a gear of 1 : 500 stay below [rad]. (physical)
LARGEST_TORQUE = 1e6  # The largest industrial arms hold some 1e5 N m [N m]. (physical)
MIN_MOTION = 1e-6  # A joint that moves by less has stood still [rad, or per_radian of a slide]. (physical)
MOVING_TORQUE = 0.3  # A torque that changes by this share of a moving recording's tells of a motion [1]. (hand)
# As few samples, that many spans of all others beyond them, are no motion: it would pass through what lies between.
LONE_SAMPLES = 3  # [1] (hand)
LONE_POSITION = 20.0  # [1] (hand)
# A joint moves if its range exceeds this share of the largest joint's, which counts as that of one that does not [1].
# (hand)
MIN_MOTION_SHARE = 0.02

# --- setup_faults: when a fault is named
# A torque is late on all joints: none is likelier without, by more than this share of what all gain [1]. (hand)
LATE_JOINT_LOSS = 0.05
# Gap over the torque's deviation beyond which no torque at all would be a better prediction [1]. (definition)
NO_TORQUE = 1.0

# --- setup_faults: search of readings
FAULT_COARSE_STEP = 4  # All candidates are compared on every so many-th sample... (budget)
FAULT_FINALISTS = 5  # ...and this many of them on all. (budget)
# Zeros off by less are no convention but the effect encoder_offset [rad]. (definition)
MIN_ZERO_OFFSET = np.deg2rad(20.0)
DECIMAL_UNITS = (1e-3, 1e-2, 1e3)  # mN m, N cm and kN m in N m [1]. (definition)
# A joint's factor is known from the nominal torque if they share this part of their variance [1]. (hand)
KNOWN_FACTOR_R2 = 0.3
REFINE_FIRST_STEP = 0.1  # First step of the logarithm of a fault's value [1]. (budget)
REFINE_LAST_STEP = 0.003  # Step at which refining a fault's value ends [1]. (budget)
# A joint whose factor is nearer to one than by an ordinary error has no other unit [1]; a factor is that of a decimal
# unit if it is no farther from it than by half as much, either way [1]. (physical)
OWN_UNIT_FACTOR = 1 + ORDINARY_ERROR
DECIMAL_UNIT_ERROR = np.sqrt(OWN_UNIT_FACTOR)

# --- setup_faults: time stamps and quantisation
FALSE_ALARM_RATE = 0.01  # How often alike recordings are said to differ, at most [1]. (statistics)
# Probability of what the recording itself or the nominal arm shows without any fit [1].
OBVIOUS_FAULT_PROBABILITY = 1 - FALSE_ALARM_RATE
NAMED_REPEATS = 0.03  # Share of repeated rows beyond which they are named [1]. (hand)
NAMED_JITTER = 0.05  # Unevenness beyond which it is named, standard deviation over the period [1]. (hand)
NAMED_LOST = 0.01  # Share of samples missing beyond which gaps are named [1]. (hand)
# Relative error of a rate beyond which it is named, and within which rates of joints are one [1]. (hand)
NAMED_RATE_ERROR = 0.03
AGREED_RATE_ERROR = 0.007  # The same if all of several recordings have the same error [1]... (hand)
RATE_REPEATED = AGREED_RATE_ERROR / 2  # ...which is that their logarithms differ by less than half of that [1].
RATE_BAND = MIN_CUTOFF  # Velocities are compared with those of the positions where these are surely right [Hz].
RATE_AGREEMENT = 0.98  # Correlation of a joint's two velocities from which on they are compared [1]. (hand)
LOG_DIGITS = 6  # Significant digits that a log keeps at least; distances below what they resolve are rounding. (hand)
CLOCK_ROUNDS = 6  # Steps of the search for its rate. (budget)
CLOCK_HINT = 0.05  # It is searched for if a first step promises to take this share of what is left [1]. (hand)
# It is named if ln of what is left falls by this, mean over joints, beside a delay alone [1]... (hand)
CLOCK_GAIN = 0.25
CLOCK_MIN_SKEW = 3e-3  # ...and the skew at the end of the longest recording exceeds this [s]. (hand)
STEP_OVER_DATA_SHEET = 1.5  # A step is named if it exceeds the data sheet's by this factor [1]. (hand)
# Step named if the data sheet is silent [rad]: a 14-bit encoder on the joint's side. Arms with gears resolve 16 to
# 20 bit there; at 14 bit the second derivative over 10 ms already jumps by 4 rad/s^2. (physical)
STEP_WITHOUT_DATA_SHEET = 2 * np.pi / 2**14
LATTICE_COHERENCE = 0.9  # Least length of the mean of exp(2 pi i q / s) [1]: 1 on a lattice, 0 without one. (hand)
LATTICE_AGREEMENT = 0.1  # Relative deviation from their median up to which steps of recordings agree [1]. (hand)
LATTICE_LEVELS = 6  # Least number of distinct positions. (hand)
LATTICE_SAMPLES = 6000  # Positions of a joint that are looked at, from each recording. (budget)

# --- setup_faults: references, velocities, gains
# Correlation of the torque with the steps of a coarse reference from which on the controller did follow them [1].
# (hand)
STEPS_IN_TORQUE = 0.3
PACE_SAMPLES = 400  # Samples of a recording on which paces are compared. (budget)
PACE_TRACKED = 0.05  # Position error over the joint's range that ordinary tracking leaves [1]. (hand)
PACE_GAIN = 4.0  # A pace is named if it lowers the error by this factor [1]. (hand)
# Paces at which the search for one starts [1], and lags of the arm behind its reference [s]. (budget)
PACE_STARTS = tuple(float(s) for s in np.geomspace(0.1, 3.0, 120))
PACE_LAGS = (0.0, 0.1, 0.3)
# A recorded velocity is the reference's if it differs from that by less than this share of how it differs from the
# arm's [1]. (hand)
REFERENCE_VELOCITY_RATIO = 0.1

LAW_BLOCKS = 8  # Blocks of each recording: a control law is fitted to every other, judged on the rest. (hand)
LAW_EXPLAINS = 0.3  # What a control law may leave of a torque that it explains, over the deviation [1]. (hand)
LAW_GAIN = 2.0  # Another law is named if it leaves less by this factor [1]. (hand)
NAMED_GAIN_FACTOR = 1.2  # Gain at work over the declared one beyond which it is named [1]... (hand)
# ...and if the torque is not recorded but what the nominal arm needs, which is not right itself [1]. (hand)
INFERRED_GAIN_FACTOR = 2.0
# ...and most joints that move show it, their factors on kp alike within this factor: a firmware scales all gains
# alike, while loads and friction of the arm differ from joint to joint [1]. (physical)
INFERRED_GAIN_SPREAD = 1.5
# A torque was computed from the log's own columns if gains leave less than this of it, over its deviation [1]: logs
# keep five digits or more, and no torque is measured that well. (physical)
EXACT_LAW = 1e-3
# A computed torque does not fit the motion if this share of what the nominal arm needs is left by it, with a free
# scale, friction and offset [1]; or this one if other gains leave less by ``LAW_GAIN``. (hand)
UNMEASURED_MISFIT = 0.7
OTHER_GAINS_MISFIT = 0.25

# --- assessment: joint torque sensors
SENSOR_ZERO = 0.1  # Prior of a sensor's zero, over the normalisation of its joint's torque gap [1]. (hand)
SENSOR_SCALE = 0.01  # Prior of the error of a sensor's scale [1]. (data sheets of joint torque sensors)
SENSOR_LAG = 2e-3  # Prior of a sensor's lag [s]. (hand)

# --- selection: search
# A joint's presliding must narrow the gap of trusted rows by what chance seldom does [nats]. (statistics)
PRESLIDING_GAIN = -np.log(FALSE_ALARM_RATE)
# An effect must lower the held-out torque NRMSE of some joint by this much to be named [1]. (definition)
VISIBLE_EFFECT = 0.01
# A joint must gain the least noise that joints have to be named with an effect that is named anyway [1].
VISIBLE_TERM = MIN_NOISE
# What a healthy arm has of an effect, in RMS torque over the joint's scale: a coordinate in 400 has more [1].
HEALTHY_TORQUE = VISIBLE_EFFECT / LIKELY
# A motor that turns two joints is suspected, where none is declared, if its friction raises the evidence beside any
# friction of both joints, and lowers the RMS of the held-out gap of both by this share [1]: a wrist with a common motor
# reaches 0.57, pairs of joints without one 0.05. (hand)
COUPLING_CLOSES = 0.2

# --- assessment: what is unknown
# What follows the motion and has no known cause is named from this RMS on, over the torque's deviation [1]: twice what
# an effect is named for; simplified laws of healthy simulated arms leave up to as much.
UNKNOWN_TORQUE = 2 * VISIBLE_EFFECT
# What complete models of healthy real arms leave of the torque, over its deviation, RMS over joints [1]: the least and
# the most of six public arms. (physical)
HEALTHY_REAL = (0.04, 0.23)
# What follows the motion of a joint has a cause if it is this many times what the other joints leave, in the geometric
# mean [1]: errors of form of healthy arms differ by as much. 1 to 2 change 4 of 54 real pieces, 1 of 38 outside. (hand)
STANDS_OUT = 1.5
# With a reference it must exceed what that leaves as if both stood out: what it leaves is an error of form, too [1].
SIGNIFICANT_RESIDUAL_RATIO = STANDS_OUT**2

# --- assessment: share of a residual that a flexible model predicts
# Waves of the posture of the arm; twice as many of a joint's signals. (budget)
FOURIER_FEATURES = 60
# Time beside the border between two folds that is not fitted [s]: held-out rows have no neighbours in it. (definition)
FOLD_GUARD = TRIM
# Strengths of the ridge that are tried, over the mean square of the columns [1]. (budget)
RIDGE_STRENGTHS = tuple(np.geomspace(3e-4, 3.0, 5).tolist())
MIN_OSCILLATION = 0.5  # Lowest frequency of an oscillation [Hz]: a slow motion does what is below. (hand)
MAX_OSCILLATION = TORQUE_CUTOFF  # Highest frequency of an oscillation [Hz]: the band of the torque gap. (definition)
# Frequencies that are tried per resolution 1 / duration: the phase has to last over the prediction. (budget)
OSCILLATION_GRID = 8

# --- assessment: probabilities, replay
OPEN_ALTERNATIVE = 0.05  # An alternative with this probability leaves the question open [1]. (hand)
NAMED_PROBABILITY = 0.5  # An effect less probable than this is not named [1]. (definition)
FALSE_DISCOVERY_RATE = 0.05  # Share of the effects confirmed that may be there by chance [1]. (statistics)
# Ticks of the controller that are replayed, from the start of a recording: 5 s at 1 kHz, which take a fifth of a
# second for each arm. (budget)
REPLAYED_TICKS = 5_000

# --- selection: bodies of the data sheet
# Errors of bodies before the data are looked at, over their size [1]: masses by CAD leave out cables, screws and
# lubricant. (physical)
INERTIAL_ERROR = 0.03

# --- localisation
REGION_SHARE = 0.25  # A region must hold this share of a joint's squared gap to be named [1]... (definition)
REGION_ENRICHMENT = 1.6  # ...and this many times what its size would give [1]: it is where to look. (definition)
JOINTS_IN_DEPTH = 3  # Joints that are looked at in depth. (budget)
REGIONS_PER_JOINT = 2  # Most regions cut in advance, and most bands, of a joint. (budget)
RULE_CONDITIONS = 3  # Most conditions of a rule: more are not read. (budget)
RULE_BLOCK = 1.0  # Rows go to learning and testing in blocks of this length [s]. (hand)
LEVEL_WINDOW = 0.25  # Length of the windows over which the level is taken [s]: three periods of the band. (budget)
MAX_INTERVALS = 2  # Most intervals of all recordings: a contact may come twice. (budget)
# An interval holds this many times the squared gap of any other of the same length [1]: a gap that comes and goes with
# the motion has no start. Chance is no measure of that: its level changes for sure. (hand)
INTERVAL_RATIO = 4.0
# Ends of the frequency bands [Hz]: octaves of what arms move at, up to the band of the gap. (definition)
OCTAVES = int(np.log2(TORQUE_CUTOFF / MIN_OSCILLATION)) + 1
BANDS = (0.0, *(MIN_OSCILLATION * 2.0**octave for octave in range(OCTAVES)), TORQUE_CUTOFF)


# --- reference: what changed since a reference
# Share by which Coulomb and viscous friction may differ from day to day, as temperature does [bittencourt2012]:
# changes beyond it are reported. (physical, the value by choice)
FRICTION_DAY_TO_DAY = 0.15
SAME_JOINT_PLACE = 2e-3  # Joints of the same arm lie in the same place in both URDFs, to this much [m, rad]. (hand)
SAME_GRAVITY = 0.05  # Gravity of the same mounting differs by no more in any component [m/s^2]. (hand)

# --- fleet: several units
# Values differ between units if one common value would scatter as much with less than this probability, divided by
# the number of values that the effect has [1]. (statistics)
FLEET_LEVEL = FALSE_ALARM_RATE
# --- fleet: one unit over time
SHORTEST_HISTORY = 3  # Least diagnoses of a unit in which a change is looked for [1]. (statistics)
# Share of the changes reported, over all units and effects, that are false on average [1]. (definition)
FALSE_CHANGES = FALSE_DISCOVERY_RATE
# Least differences of successive estimates from which scatter beyond their deviations is estimated [1]. (statistics)
MIN_DIFFERENCES = 20

# --- fleet: which unit is which
# Two arms predict a unit alike if no joint's torque NRMSE differs by this much [1]. (definition)
ALIKE_NRMSE = VISIBLE_EFFECT

# --- agreement: whether recordings agree
# A quantity goes with a difference if it explains this share of the squared deviations [1]... (hand)
COVARIATE_SHARE = 0.8
# ...and differs between the recordings by this share of its mean [1]... (hand)
COVARIATE_CHANGE = 0.1
COVARIATE_TEMPERATURE = 2.0  # ...or, a temperature, by this much [K]. (physical)

# --- advice: the next recording
DESIGNED_ALTERNATIVES = 3  # Most alternatives that one recording is designed for; the most probable ones. (hand)
SCREENING_SHARE = 0.3  # Share of the evaluations that go to comparing the options [1]. (budget)
MIN_SCREENING = 20  # Evaluations for each option, at least. (budget)
PAYLOAD_WORTH = 1.25  # A payload is mounted if it raises the expected evidence by this factor [1]. (hand)
TIMES_RECORDED = 3  # A motion may be recorded so many times to settle a question. (hand)
