"""The linear problem of an identification: columns, friction, samples in a band, and whether they suffice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import periodogram

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import units_of
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import STILL, Recording, resting
from gapscope.arm.root_mean_square import rms
from gapscope.effects.friction import (
    PRESLIDING_DISTANCES,
    SATURATION_SPEEDS,
    STRIBECK_SPEEDS,
    friction_direction,
    saturating_amplitude,
    stribeck_amplitude,
)
from gapscope.ident.model.base_parameters import ROUNDING, TINY, WORTH
from gapscope.ident.model.physical_parameters import LEAST_MASS, LENGTH
from gapscope.ident.model.regressor import Regressor
from gapscope.model.conditioning import Segment, blocks, condition
from gapscope.model.effective_samples import band_samples, group_slices
from gapscope.model.rows import DecimatedSegments

# The linear problem of an identification: columns, friction, samples in a band, and whether they suffice.


# The linear problem of identification, tau = W beta + noise.


@dataclass(frozen=True)
class Problem:
    """Tau = W beta + noise, N samples of n joints, b parameters.

    Attributes:
        matrix: W, shape (N, n, b); base columns, so that it has full rank, unless said otherwise.
        torque: tau [N m], shape (N, n).
        names: of the parameters, shape (b,).
        group: which recording (or stretch of one) a sample belongs to, shape (N,), integers that do not fall.
        interval: time from each sample to the next of its group [s], shape (N,): recordings have rates of their own.
        forms: unknown functions of each joint that no column has, (N, n, K); each array has amplitudes of its own.
    """

    matrix: np.ndarray
    torque: np.ndarray
    names: Sequence[str]
    group: np.ndarray
    interval: np.ndarray
    forms: Sequence[np.ndarray] = ()

    @property
    def n_joints(self) -> int:
        """Number n of joints."""
        return self.torque.shape[1]

    def stacked(self) -> tuple[np.ndarray, np.ndarray]:
        """W of shape (N n, b) and tau of shape (N n,)."""
        return self.matrix.reshape(-1, self.matrix.shape[2]), self.torque.ravel()

    def residual(self, beta: np.ndarray) -> np.ndarray:
        """Tau - W beta [N m], shape (N, n)."""
        return self.torque - self.matrix @ beta

    def rows(self, chosen: np.ndarray | slice) -> Problem:
        """The problem of some samples only."""
        return Problem(
            self.matrix[chosen],
            self.torque[chosen],
            self.names,
            self.group[chosen],
            self.interval[chosen],
            [each[chosen] for each in self.forms],
        )


def equal_parts(rows: slice, count: int) -> list[slice]:
    """A slice cut into parts of about equal length, empty ones left out."""
    edges = np.linspace(rows.start, rows.stop, count + 1).astype(int).tolist()
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def parts_within(group: np.ndarray, length: float) -> list[slice]:
    """Parts of about a length [samples] within the groups of samples, (N,); at least one of each group."""
    out = []
    for rows in group_slices(group):
        count = max(1, round((rows.stop - rows.start) / length))
        out += equal_parts(rows, count)
    return out


# Friction of drives as columns: direction of motion, its memory at rest, Stribeck and saturating friction.


MOVING = 0.05
"""A joint moves when it is faster than this [rad/s]."""
STRIBECK_TRIED = tuple(np.geomspace(MOVING, STRIBECK_SPEEDS.highest, 7).tolist())
"""Speeds vs tried for d exp(-(v / vs)^2) [rad/s]."""


@dataclass(frozen=True)
class FrictionLaw:
    r"""Friction of every drive beside b v: (c + d exp(-(v / vs)^2) + s tanh(\|v\| / vt)) e, e the direction of motion.

    Attributes:
        stribeck_speed: vs [rad/s]; ``None``: no such term.
        saturation_speeds: vt of each drive [rad/s]; ``None``: no such term.
        presliding: distance of each drive over which e turns from -1 to 1 [rad], so that it keeps its value at rest;
            0 or ``None``: e is the smoothed sign of the velocity, as in the effects' catalogue.
    """

    stribeck_speed: float | None = None
    saturation_speeds: tuple[float, ...] | None = None
    presliding: tuple[float, ...] | None = None

    @property
    def shapes(self) -> tuple[str, ...]:
        """Symbols of the columns per drive: c, d if there is a Stribeck term, s if there is one that saturates."""
        stribeck = () if self.stribeck_speed is None else ("d",)
        saturating = () if self.saturation_speeds is None else ("s",)
        return ("c", *stribeck, *saturating)

    def columns(self, position: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
        """What c, d and s multiply [1], from position [rad] and velocity [rad/s] of shape (N, k); each (N, k)."""
        at_once = (0.0,) * velocity.shape[1]
        distance = np.array(self.presliding or at_once)
        sign = friction_direction(position, velocity, distance)
        columns = [sign]
        for speeds, amplitude in (
            (self.stribeck_speed, stribeck_amplitude),
            (self.saturation_speeds, saturating_amplitude),
        ):
            if speeds is not None:
                columns.append(
                    sign * amplitude(velocity, sign, np.ones(1), np.array(speeds))
                )
        return columns

    def __str__(self) -> str:
        """In words, for the report."""
        parts = ["Coulomb and viscous"]
        if self.stribeck_speed is not None:
            parts.append(f"Stribeck below {self.stribeck_speed:.2g} rad/s")
        if self.saturation_speeds is not None:
            speeds = ", ".join(f"{speed:.2g}" for speed in self.saturation_speeds)
            parts.append(f"saturating above {speeds} rad/s")
        if self.presliding is not None:
            distances = ", ".join(f"{1e3 * x:.2g}" for x in self.presliding)
            parts.append(
                f"direction kept at rest, turned round within {distances} mrad"
            )
        return ", ".join(parts)


def drives(arm: NominalArm) -> tuple[np.ndarray, tuple[str, ...]]:
    """What turns: D with speeds D dq [1], shape (n + k, n): the joints, then the k motors that move several of them.

    The speed of a motor, and the friction along D^T, count on the side of the joint of its own number.

    Returns:
        D, and labels: ``1`` to ``n``, and ``6m`` for motor 6.
    """
    joints = np.eye(arm.n_joints)
    labels = tuple(str(j + 1) for j in range(arm.n_joints))
    if arm.coupling is None or not arm.coupled_motors:
        return joints, labels
    # other motors turn one joint each: they are the joint's own drive
    rows = arm.coupling[[motor - 1 for motor in arm.coupled_motors]]
    motors = tuple(f"{motor}m" for motor in arm.coupled_motors)
    return np.vstack([joints, rows]), (*labels, *motors)


# The model of the pipeline, tau = W x: rigid bodies, rotors and friction of joints and coupled motors, offsets.


SMOOTH = ("rotor", "damping", "offset")
"""Quantities of drives whose columns do not depend on the friction law."""
MIN_ARM = LENGTH / 2
"""Lever that a link's first moment is at least counted with in its unit [m]."""


class ModelColumns:
    """W with tau = W x for an arm of n joints.

    First the ten inertial parameters of each link, rotor inertia I [kg m^2], viscous friction b [N m s/rad] and offset
    o [N m] of each joint, and I and b of each motor that moves several joints (``I6m``: motor 6, on the side of joint
    6); then dry friction by a ``FrictionLaw``: c and d [N m] of joints and coupled motors.

    The friction law counts positions and speeds of slides in what counts as a radian of them.

    Args:
        arm: the nominal arm; its coupling says which motors move several joints.
        body: rigid bodies of the arm; built if ``None``.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody | None = None,
    ) -> None:
        self.arm, self.body = arm, body or RigidBody(arm)
        self.drives, self.labels = drives(arm)
        self.regressor = Regressor(arm, self.body, SMOOTH)
        self._motors = arm.coupled_motors
        own = arm.per_radian[[motor - 1 for motor in self._motors]]
        self.per_radian = np.r_[arm.per_radian, own]
        self.links = 10 * arm.n_joints

    @property
    def coupled(self) -> tuple[str, ...]:
        """Labels of the coupled motors, ``6m``."""
        return self.labels[self.arm.n_joints :]

    def names(self, law: FrictionLaw) -> tuple[str, ...]:
        """Names of x, shape (p,)."""
        smooth = [f"{symbol}{label}" for symbol in ("I", "b") for label in self.coupled]
        dry = [f"{shape}{label}" for shape in law.shapes for label in self.labels]
        return (*self.regressor.names, *smooth, *dry)

    def units(self, law: FrictionLaw) -> tuple[str, ...]:
        """Units of x, shape (p,)."""
        slides = (*self.arm.sliding, *(self.arm.sliding[m - 1] for m in self._motors))
        coupled = slides[self.arm.n_joints :]
        dry = units_of("N m", slides) * len(law.shapes)
        smooth = (*units_of("kg m^2", coupled), *units_of("N m s/rad", coupled))
        return (*self.regressor.units, *smooth, *dry)

    def nominal(self, law: FrictionLaw) -> np.ndarray:
        """The x of the nominal arm and its data sheet, shape (p,)."""
        sheet = self.regressor.nominal()
        # rotor inertia and viscous friction of coupled motors are no part of the sheet
        motors = np.zeros(2 * len(self.coupled))
        dry = np.zeros((len(law.shapes), len(self.drives)))
        # the data sheet gives Coulomb friction of the joints alone
        dry[0, : self.arm.n_joints] = self.arm.coulomb
        return np.concatenate([sheet, motors, dry.ravel()])

    def smooth(self, motion: Motion) -> np.ndarray:
        """Columns that do not depend on the friction law, shape (N, n, p_smooth)."""
        # the first n drives are the joints: the regressor has theirs
        motors = self.drives[self.arm.n_joints :]
        links = self.regressor.matrix(motion)
        inertia = _along(motion.ddq @ motors.T, motors)
        viscous = _along(motion.dq @ motors.T, motors)
        return np.concatenate([links, inertia, viscous], axis=2)

    def dry(self, motion: Motion, law: FrictionLaw) -> np.ndarray:
        """Columns of dry friction, shape (N, n, p_dry)."""
        # of drives that slide, what counts as a radian is one
        to = self.drives.T / self.per_radian
        return np.concatenate(
            [
                _along(x, self.drives)
                for x in law.columns(motion.q @ to, motion.dq @ to)
            ],
            axis=2,
        )

    def matrix(self, motion: Motion, law: FrictionLaw) -> np.ndarray:
        """W of a motion of N samples, shape (N, n, p)."""
        return np.concatenate([self.smooth(motion), self.dry(motion, law)], axis=2)

    def scale(self, law: FrictionLaw) -> np.ndarray:
        """Change of x that counts as 100 %, shape (p,); infinite for parameters that the nominal arm need not have.

        Mass m; first moments m max(|c|, 5 cm); inertia about the joint frame, half its trace.
        """
        out = np.full(len(self.names(law)), np.inf)
        links = self.body.inertial_parameters().reshape(-1, 10)
        # links of almost no mass still may gain some
        mass = np.maximum(links[:, 0], LEAST_MASS)
        moment = np.maximum(np.linalg.norm(links[:, 1:4], axis=1), MIN_ARM * mass)
        # half the trace, Ixx + Iyy + Izz
        half = 0.5 * links[:, [4, 6, 9]].sum(axis=1)
        # a link without inertia counts as if it lay 1 cm from its frame's origin
        inertia = np.maximum(half, mass * (0.2 * MIN_ARM) ** 2)
        sizes = np.stack([mass, moment, inertia], axis=1)
        # one size for the mass, for three first moments, and for six of inertia
        out[: self.links] = np.repeat(sizes, [1, 3, 6], axis=1).ravel()
        return out


def _along(series: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Columns along the drives' directions: (N, k) and (k, n) to (N, n, k)."""
    return series[:, None, :] * directions.T[None]


# Whether samples can determine parameters, and if not, why: causes before a solver meets them.


UNIT_FACTOR = 5.0
"""Torque larger or smaller than the nominal arm's by more than this is suspected of another unit: friction that no data
sheet states may be several times as large as the rest [1]."""


def check_samples(
    problem: Problem, *, full_rank: bool = True, rows: np.ndarray | None = None
) -> None:
    """Check that the samples determine the parameters.

    Args:
        problem: to be solved.
        full_rank: whether every parameter must be determined by the samples alone.
        rows: fewer rows than the problem's with the same sums of squares, (K, b), if there are some.

    Raises:
        InputError: a value is not finite; too few samples; a trajectory that rests; columns that depend on each other.
    """
    # first of all: one value that is no number spoils every later check
    for values, what, remedy in (
        (problem.torque, "torque", "drop or repair the rows; none is guessed"),
        (problem.matrix, "matrix", "drop rows of q, dq or ddq that are not finite"),
    ):
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            wrong = len(np.unique(bad[:, 0]))
            raise InputError(
                f"is not a finite number in {wrong} of {len(values)} samples, first in sample {bad[0][0] + 1}, joint "
                f"{bad[0][1] + 1}. Either (a) the log has gaps filled with NaN, (b) a column holds text or is empty, "
                "or (c) a division in the import went wrong",
                remedy,
                where=what,
            )
    # each sample gives an equation for every joint
    equations, b = problem.torque.size, problem.matrix.shape[2]
    if full_rank and equations <= b:
        raise InputError(
            f"{len(problem.torque)} samples of {problem.n_joints} joints are {equations} equations for {b} parameters: "
            "too few. Either (a) the recording is too short, (b) filtering and trimming left little of it, or (c) the "
            "model has more parameters than this arm needs",
            "record for longer, or use base parameters, or an estimator with a prior (ridge, partial update)",
            where="samples",
        )
    # columns that vary by no more than rounding belong to an arm that rests
    spread = np.ptp(problem.matrix, axis=0).max(initial=0.0)
    if spread <= ROUNDING * float(np.abs(problem.matrix).max(initial=0.0)):
        raise InputError(
            "the trajectory is constant: every sample gives the same equations. Either (a) the arm rested while it was "
            "recorded, (b) the position columns are not those of the moving joints, or (c) positions were rounded away",
            "record an exciting trajectory (`gapscope excite`)",
            where="q",
        )
    if full_rank:
        check_rank(problem.stacked()[0] if rows is None else rows, problem.names)


def unit_warnings(problem: Problem, nominal: np.ndarray) -> tuple[str, ...]:
    """Warnings about torque that is suspiciously small or large against the nominal arm's.

    Args:
        problem: with torque [N m] as recorded.
        nominal: parameters of the nominal arm, shape (b,), in the problem's columns.
    """
    recorded, expected = (rms(x) for x in (problem.torque, problem.matrix @ nominal))
    # joints that need hardly any torque say nothing of its unit
    loaded = expected > 0.05 * expected.max(initial=0.0)
    if not loaded.any():
        return ()
    # the median: one joint with a load or a spring changes no unit
    factor = float(np.median(recorded[loaded] / expected[loaded]))
    if 1 / UNIT_FACTOR < factor < UNIT_FACTOR:
        return ()
    size = "large" if factor > 1 else "small"
    return (
        f"the recorded torque is suspiciously {size}: {factor:.3g} times the nominal arm's. Either (a) its unit is not "
        "N m (N mm: 1000, N cm: 100), (b) it is a motor current, or a motor-side torque without the gear ratio, or (c) "
        "the nominal arm is another arm; state unit and transmission in import:, or correct the URDF",
    )


def check_rank(matrix: np.ndarray, names: Sequence[str]) -> None:
    """Check that rows of equations, (K, b), determine every parameter; raises ``InputError`` otherwise."""
    # fewer equations than columns: rows of zeros show what is left open
    missing = max(0, matrix.shape[1] - len(matrix))
    matrix = np.pad(matrix, ((0, missing), (0, 0)))
    norms = np.linalg.norm(matrix, axis=0)
    unit = matrix / np.where(norms > 0, norms, 1.0)
    # the pivot of a column is what those before it do not explain
    pivots = np.abs(np.diag(np.linalg.qr(unit, mode="r")))
    if (pivots > ROUNDING).all():
        return
    open_names = ", ".join(np.asarray(names)[pivots <= ROUNDING])
    raise InputError(
        f"the samples do not determine {open_names}. Either (a) the trajectory does not excite them, (b) the columns "
        "are not base parameters, so that some depend on others, or (c) a joint that they need did not move",
        "record an exciting trajectory (`gapscope excite`), use base parameters, or an estimator with a prior",
        where="matrix",
    )


# The samples of the pipeline: segments with torque, both sides of tau = W x through the same filter.


PER_CUTOFF = 4.0
"""Samples per period of the cut-off that are kept to fit; more hold no further information."""
MOST = 20_000
"""Samples that are kept at most: long recordings are thinned further, which bounds the memory."""
LONGEST = 60.0
"""Longer segments are worked on in blocks of at most this [s]."""
AT_LIMIT = 0.99
"""Share of its limit from which a torque is at it [1]."""


class Samples(DecimatedSegments):
    """Samples to fit, of both sides of tau = W x in one band, stacked over segments and thinned to what it holds.

    Positions are filtered at the cut-off as well. Columns at the full rate are held of one segment at a time. Where a
    torque was not measured, both sides of its equation are zero: it says nothing.

    Args:
        columns: the model.
        recordings: those without torque are left out.
        cutoff: of positions, columns and torque [Hz].
        trim: whether both ends of a segment, where the filter settles, are left out.
        thinning: by which factor fewer samples are kept than the band holds [1]; as many as ``MOST`` asks for if
            ``None``.

    Attributes:
        segments: of the recordings; trimmed ones in blocks, whose samples follow each other without a gap.
        smooth: columns that do not depend on the friction law, in the band, shape (M, n, p_smooth).
        torque: recorded torque in the band, less that of known loads [N m], shape (M, n).
        velocity: dq [rad/s], shape (M, n).
        measured: whether the torque was measured there, shape (M, n): see ``Segment.unknown``.
        times: of the recording that a sample belongs to [s], shape (M,).
        group: number of the segment of each sample, shape (M,).
        interval: time from each sample to the next of its segment [s], shape (M,).
    """

    def __init__(
        self,
        columns: ModelColumns,
        recordings: Sequence[Recording],
        cutoff: float,
        trim: bool = True,
        thinning: int | None = None,
    ) -> None:
        self.columns, self.trim, self.thinning = columns, trim, thinning or 1
        known = [r for r in recordings if r.tau is not None]
        segments = [s for r in known for s in condition(r, cutoff)]
        if trim:
            seconds = [len(s.motion.t) / s.motion.rate for s in segments]
            counts = [int(np.ceil(length / LONGEST)) for length in seconds]
            pairs = zip(segments, counts, strict=True)
            segments = [part for s, count in pairs for part in blocks(s, count)]
        super().__init__(segments, cutoff)
        if thinning is None:
            count = sum(len(s.motion.t) / self.step(s) for s in segments)
            self.thinning = max(1, int(np.ceil(count / MOST)))
        kept = [(s, self.taken(s)) for s in segments]
        self.times = np.concatenate([s.motion.t[rows] for s, rows in kept])
        self.velocity = np.concatenate([s.motion.dq[rows] for s, rows in kept])
        self.measured = np.concatenate([s.measured[rows] for s, rows in kept])
        self.smooth = self.filtered_each(columns.smooth)
        self.torque = self.rows(
            s.torque - s.known_torque(columns.body) for s in segments
        )
        lengths = [len(s.motion.t[rows]) for s, rows in kept]
        self.group = np.repeat(np.arange(len(lengths)), lengths)
        steps = [self.step(s) / s.motion.rate for s in segments]
        self.interval = np.repeat(steps, lengths)

    def of(
        self, recordings: Sequence[Recording], thinning: int | None = None
    ) -> Samples:
        """Samples of other recordings in the same band."""
        return Samples(self.columns, recordings, self.cutoff, self.trim, thinning)

    def inner(self, segment: Segment) -> slice:
        """The samples of a segment that count."""
        return segment.inner if self.trim else slice(0, len(segment.motion.t))

    def step(self, segment: Segment) -> int:
        """Every which sample is kept to fit."""
        # down to whole samples; 1e-6 for a quotient that rounding made less
        within_band = int(segment.motion.rate / (PER_CUTOFF * self.cutoff) + 1e-6)
        return self.thinning * max(1, within_band)

    def rows(self, series: Iterable[np.ndarray]) -> np.ndarray:
        """Series of every segment, (N, n, ...) each, on its rows; zero where the torque was not measured."""
        stacked = super().rows(series)
        stacked[~self.measured] = 0.0
        return stacked

    def filtered_each(self, series: Callable[[Motion], np.ndarray]) -> np.ndarray:
        """A function of the motion, (N, n, ...), on the rows; shape (M, n, ...)."""
        return self.rows(series(s.motion) for s in self.segments)

    def matrix(self, law: FrictionLaw) -> np.ndarray:
        """W in the band, shape (M, n, p)."""
        dry = self.filtered_each(lambda motion: self.columns.dry(motion, law))
        return np.concatenate([self.smooth, dry], axis=2)

    def problem(
        self, law: FrictionLaw, kept: np.ndarray, names: Sequence[str]
    ) -> Problem:
        """The linear problem in the columns ``kept``."""
        matrix = self.matrix(law)[:, :, kept]
        return Problem(matrix, self.torque, tuple(names), self.group, self.interval)


# How many independent samples a motion gives for each parameter.


ADVISED = 10.0
"""Independent samples per base parameter below which there is a warning [1]."""
POWER = 0.99
"""Share of the torque's power that lies within its bandwidth [1]."""


@dataclass(frozen=True)
class SampleCount:
    """How much information the fitted recordings hold.

    Attributes:
        seconds: length of the fitted samples [s].
        bandwidth: frequency below which ``POWER`` of the torque's power about its mean lies [Hz], shape (n,).
        independent: sum_j 2 B_j T, the independent samples of all joints [1].
        per_parameter: of these per base parameter [1].
    """

    seconds: float
    bandwidth: np.ndarray
    independent: float
    per_parameter: float

    def warnings(self, *, model_error: bool) -> tuple[str, ...]:
        """A warning if there are fewer than ``ADVISED`` per parameter, or none.

        Args:
            model_error: whether the residual follows the motion; then faster motion only hides what the model lacks.
        """
        if self.per_parameter >= ADVISED:
            return ()
        needed = self.seconds * ADVISED / self.per_parameter
        faster = "" if model_error else ", or move faster"
        return (
            f"{self.seconds:.3g} s of motion up to {self.bandwidth.max():.2g} Hz hold about {self.per_parameter:.1f} "
            f"independent samples per base parameter, {ADVISED:g} are advised: intervals and validation say less than "
            f"they seem to; record for {needed:.2g} s{faster}",
        )


def count_samples(samples: Samples, parameters: int) -> SampleCount:
    """Count by the bandwidth B of the recorded torque: a band of B Hz holds 2 B independent samples a second."""
    frequencies, energies = [], []
    for rows in group_slices(samples.group):
        interval, torque = samples.interval[rows.start], samples.torque[rows]
        frequency, power = periodogram(
            torque, 1 / interval, "hann", scaling="spectrum", axis=0
        )
        frequencies.append(frequency)
        # groups differ in length: of longer ones the same power is more energy
        energies.append(power * len(torque) * interval)
    frequency = np.concatenate(frequencies)
    order = np.argsort(frequency, kind="stable")
    below = np.cumsum(np.concatenate(energies)[order], axis=0)
    share_below = below / np.maximum(below[-1], TINY)
    bandwidth = frequency[order][np.argmax(share_below >= POWER, axis=0)]
    seconds = float(samples.interval.sum())
    independent = band_samples(seconds, float(bandwidth.sum()))
    return SampleCount(seconds, bandwidth, independent, independent / parameters)


# Which recordings are fitted, and which are held out.


HELD_OUT = 1 / 3
"""Share of a single recording that is held out, its end [1]."""


def split(
    case: Case, chosen: Sequence[str] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit, and held-out ones: those chosen by name, else the case's, else the last one or the last third.

    Raises:
        InputError: a name is not that of a recording, or none remains to fit.
    """
    everything = [*case.recordings, *case.judged]
    for name in chosen:
        if name not in [recording.name for recording in everything]:
            raise InputError(
                f"no recording is called {name!r}",
                f"there are {', '.join(r.name for r in everything)}",
                where="--judge",
            )
    if case.judged and not chosen:
        return list(case.recordings), list(case.judged)
    if not chosen and len(everything) == 1:
        (only,) = everything
        # its end as a whole: samples beside fitted ones are no test of a model
        cut = int(len(only.t) * (1 - HELD_OUT))
        start = only.part(slice(0, cut), name=f"{only.name}, start")
        end = only.part(slice(cut, None), name=f"{only.name}, end")
        return [start], [end]
    held = list(chosen) or [everything[-1].name]
    fit = [r for r in everything if r.name not in held]
    if not fit:
        raise InputError(
            "every recording is held out, none remains to fit", where="--judge"
        )
    return fit, [r for r in everything if r.name in held]


# Whether samples can be identified from at all; what cannot is refused with the reason, before any fit.


PER_PARAMETER = 2.0
"""Independent samples that each base parameter needs at least; a band of f Hz holds 2 f a second and joint."""


def check_bare(recording: Recording, remedy: str) -> None:
    """Check that a recording carries no known payload; raises ``InputError`` with a remedy otherwise."""
    if recording.payload is not None:
        raise InputError(
            "carries a known payload, and what simulates the arm to identify it simulates it without",
            remedy,
            file=recording.name,
        )


def check_recordings(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    case: Case,
) -> None:
    """Check that there is torque to fit and to hold out, and that something moves.

    Raises:
        InputError: no recording has a torque that can be trusted, or all joints rest.
    """
    if not any(recording.tau is not None for recording in recordings):
        notes = "; ".join(
            dict.fromkeys(note for recording in recordings for note in recording.notes)
        )
        raise InputError(
            "no recording holds a torque" + (f" ({notes})" if notes else ""),
            "record tau1..taun, the torque commanded or derived from motor current, or name its columns in the case's "
            "import: {tau: ...}; what the torque is not known of cannot be identified",
            file=case.name,
        )
    if not any(recording.tau is not None for recording in held_out):
        raise InputError(
            f"{', '.join(r.name for r in held_out)}, held out, has no torque",
            "name another recording with --judge",
            file=case.name,
        )
    # one moving joint is enough: what the others leave open is said later
    if resting([r for r in recordings if r.tau is not None], case.arm.per_radian).all():
        raise InputError(
            f"the trajectory is constant: no joint moves by {STILL:g} rad within a recording",
            "record a motion in which all joints speed up, slow down and turn round (`gapscope excite` plans one)",
            file=recordings[0].name,
            where="columns q1 on",
        )


# Laws of friction of an identification: their columns, trials, and the choice between them.


# How well laws of friction predict stretches of time that were held out; laws differ in the dry columns alone.


FOLDS = 5
"""Least number of stretches of time, each predicted from all others."""
SHORTEST = 20
"""Samples of a stretch, about, at least."""


class FrictionTrials:
    """Samples on which laws of friction are tried; what all laws share is summed once.

    Args:
        samples: what may be fitted.
        noise: RMS residual per joint [N m], shape (n,).
    """

    def __init__(self, samples: Samples, noise: np.ndarray) -> None:
        self.samples, self.noise = samples, noise
        self.stretches = stretches(samples.group)
        torque = samples.torque[:, :, None]
        # the columns of dry friction stand between these
        self._shared = np.concatenate([samples.smooth, torque], axis=2)
        self._shared /= noise[:, None]
        # the Gram matrix of each stretch, and last that of all samples
        spans = [*self.stretches, slice(0, len(torque))]
        flat = [self._shared[k].reshape(-1, self._shared.shape[2]) for k in spans]
        self._grams = [(k, x.T @ x) for k, x in zip(spans, flat, strict=True)]

    def under(
        self, law: FrictionLaw
    ) -> tuple[Callable[[float], np.ndarray], Callable[[float], np.ndarray]]:
        """What a law is worth and what it finds, by the strength of the pull.

        Returns:
            Mean square of residual over noise, per joint [1], (n,), of each stretch from all others; and x, fitted to
            all samples, (p,).
        """
        columns = self.samples.columns
        dry = self.samples.filtered_each(lambda motion: columns.dry(motion, law))
        dry /= self.noise[:, None]
        shared, own = self._shared.shape[2], dry.shape[2]
        # the torque comes last
        order = [*range(shared - 1), *range(shared, shared + own), shared - 1]
        # of [W, y] of each stretch, and last of all
        grams = []
        for rows, gram in self._grams:
            friction = dry[rows].reshape(-1, own)
            cross = self._shared[rows].reshape(-1, shared).T @ friction
            whole = np.block([[gram, cross], [cross.T, friction.T @ friction]])
            grams.append(whole[np.ix_(order, order)])
        # the same pull for every stretch, that of all samples
        penalty = penalties(self.samples, law, np.diag(grams[-1])[:-1])
        nominal = columns.nominal(law)
        total, joints = np.sum(grams[:-1], axis=0), len(self.noise)
        sizes = [joints * (rows.stop - rows.start) for rows in self.stretches]
        smooth = shared - 1

        def held_out(pull: float) -> np.ndarray:
            squares = np.zeros(joints)
            for rows, gram, size in zip(self.stretches, grams, sizes, strict=False):
                # the Gram matrix of all other stretches, without forming their equations again
                count = sum(sizes) - size
                x = pulled_solution(total - gram, count, pull * penalty, nominal)
                # what is left at unit noise: [W, y] times (-x, 1)
                z = np.append(-x[:smooth], 1.0)
                left = self._shared[rows] @ z - dry[rows] @ x[smooth:]
                squares += (left**2).sum(axis=0)
            # sizes count the rows of all joints
            return squares * joints / sum(sizes)

        def fitted(pull: float) -> np.ndarray:
            size = self.samples.torque.size
            return pulled_solution(grams[-1], size, pull * penalty, nominal)

        return held_out, fitted


LOOSE = 1e-8
"""Strength of the pull on parameters that the nominal arm need not have, over that on all others [1]."""


def penalties(samples: Samples, law: FrictionLaw, squares: np.ndarray) -> np.ndarray:
    """Diagonal of the pull's quadratic form for pull 1 [1/x^2], shape (p,): 1 / scale^2, a trace elsewhere.

    ``squares`` are the sums of squares of the columns at unit noise, (p,).
    """
    scale = samples.columns.scale(law)
    size = np.sqrt(squares / len(samples.torque))
    # a weak prior on parameters that the nominal arm need not have keeps the system regular
    trace = LOOSE * np.where(size > 0, size, 1.0) ** 2
    return np.where(np.isfinite(scale), scale**-2.0, trace)


def pulled_solution(
    gram: np.ndarray, rows: int, penalty: np.ndarray, nominal: np.ndarray
) -> np.ndarray:
    """Argmin |y - W x|^2 / noise^2 + rows (x - x0)^2 penalty, from the Gram matrix of [W, y]; shape (p,)."""
    own, right = gram[:-1, :-1], gram[:-1, -1]
    weight = rows * penalty
    # columns differ by orders of magnitude: scaled to a unit diagonal
    unit = 1.0 / np.sqrt(np.diag(own) + weight)
    system = (own + np.diag(weight)) * unit[:, None] * unit
    # solved for the departure from nominal: the right side is what nominal leaves
    change = np.linalg.solve(system, unit * (right - own @ nominal))
    return nominal + unit * change


def stretches(group: np.ndarray) -> list[slice]:
    """Stretches of time within segments, at least ``FOLDS`` in all, of about equal length; two samples apart."""
    length = max(SHORTEST, len(group) // max(FOLDS, len(group_slices(group))))
    parts = parts_within(group, length)
    return [slice(p.start + 1, p.stop - 1) for p in parts if p.stop - p.start > 2]


# Form of the friction and strength of the pull to the nominal arm, chosen by validation inside the fitted samples.


EXCEEDED = 3.0
"""Every moving drive must be faster at times than a Stribeck speed by this factor."""
PULLS = np.logspace(-4, 4, 9)
"""Strengths of the pull to the nominal arm that are tried [1]."""


@dataclass(frozen=True)
class Choice:
    """What validation inside the fitted samples chose.

    Attributes:
        law: form of the dry friction.
        pull: weight of ((x - x0) / scale)^2 beside the mean square of the weighted residual [1].
        noise: RMS residual per joint [N m], shape (n,), the weights' inverse.
        stribeck_gain: share by which a Stribeck term lowers the error on held-out stretches [1]; 0 if none was tried.
        tried: law and pull in words, with the error on held-out stretches [1]: RMS of residual over the noise, of
            laws over what the plain one leaves, and then of each of ``PULLS`` over ``noise``.
    """

    law: FrictionLaw
    pull: float
    noise: np.ndarray
    stribeck_gain: float
    tried: tuple[tuple[str, float], ...]


def choose(
    samples: Samples, *, nonlinear: bool = True, presliding: bool = True
) -> Choice:
    """Choose the friction law, then the pull; the simpler one unless the richer one is clearly better.

    Args:
        samples: what may be fitted.
        nonlinear: whether a Stribeck term, or one that saturates with speed, may be chosen.
        presliding: whether friction that keeps its direction at rest may be chosen.
    """
    # a weak pull: the form of the friction is judged by the data
    law, pull = FrictionLaw(), float(PULLS[1])
    trials = FrictionTrials(samples, joint_noise(samples, law, pull))
    best = _error(trials.under(law)[0](pull))
    tried = [(f"{law}; pull {pull:g}", best)]
    # the simpler law stays unless the richer one is worth its parameters
    plain, gains = best, []
    for candidate in _nonlinear_laws(samples) if nonlinear else []:
        held_out, fitted = trials.under(candidate)
        # a term is positive on the whole; a negative one stands for another law
        # the columns of the richer term come last, one for each drive
        if fitted(pull)[-len(samples.columns.labels) :].sum() <= 0:
            continue
        error = _error(held_out(pull))
        tried.append((f"{candidate}; pull {pull:g}", error))
        if candidate.stribeck_speed is not None:
            gains.append(1 - error / plain)
        if error < min(best, (1 - WORTH) * plain):
            law, best = candidate, error
    distances = _presliding_distances(trials, law, pull) if presliding else ()
    if any(distances):
        candidate = replace(law, presliding=distances)
        error = _error(trials.under(candidate)[0](pull))
        tried.append((f"{candidate}; pull {pull:g}", error))
        # its distances had to be worth it drive by drive already
        law = candidate if error < best else law
    # the pull is chosen last: it depends little on the form of the friction
    trials = FrictionTrials(samples, joint_noise(samples, law, pull))
    held_out, _ = trials.under(law)
    errors = [_error(held_out(value)) for value in PULLS]
    pairs = zip(PULLS, errors, strict=True)
    tried += [(f"{law}; pull {value:g}", error) for value, error in pairs]
    pull = float(PULLS[np.argmin(errors)])
    noise = joint_noise(samples, law, pull)
    return Choice(law, pull, noise, max(gains, default=0.0), tuple(tried))


def _error(mse: np.ndarray) -> float:
    """RMS of residual over noise on held-out stretches [1], of the mean squares of the joints, (n,)."""
    return float(np.sqrt(mse.mean()))


def _nonlinear_laws(samples: Samples) -> list[FrictionLaw]:
    """Laws with a Stribeck term, or one that saturates with speed, as far as the recorded speeds can show them."""
    columns = samples.columns
    # a motor's speed is its mixture of joint speeds
    speeds = np.abs(samples.velocity @ columns.drives.T) / columns.per_radian
    fastest = speeds.max(axis=0)
    moving = fastest[fastest > MOVING]
    if not len(moving):
        return []
    # every moving drive exceeds a Stribeck speed by far: beyond the recorded speeds the law is extrapolated
    laws = [
        FrictionLaw(stribeck_speed=speed)
        for speed in STRIBECK_TRIED
        if EXCEEDED * speed <= moving.min()
    ]
    # a drive that hardly moves still needs a speed for its column
    scaled = np.maximum(fastest, MOVING)
    grid = SATURATION_SPEEDS
    for share in np.geomspace(grid.lowest, grid.highest, grid.points):
        laws.append(FrictionLaw(saturation_speeds=tuple((share * scaled).tolist())))
    return laws


def _presliding_distances(
    trials: FrictionTrials, law: FrictionLaw, pull: float
) -> tuple[float, ...]:
    """Per drive the distance that predicts the torque of its joints best [rad]; 0 if the smoothed sign is better.

    Friction that holds a joint at rest is the rule [dahl1976], so the smoothed sign has to be worth it.
    """
    drives = trials.samples.columns.drives
    distances = (0.0, *PRESLIDING_DISTANCES)
    errors = []
    for distance in distances:
        same = replace(law, presliding=(distance,) * len(drives))
        errors.append(trials.under(same)[0](pull))
    # a motor that turns several joints is judged by all, each by its part
    turned = np.abs(drives) / np.abs(drives).sum(axis=1, keepdims=True)
    by_drive = np.array(errors) @ turned.T
    # worth is said of RMS, these are mean squares
    by_drive[0] *= (1.0 + WORTH) ** 2
    return tuple(distances[k] for k in by_drive.argmin(axis=0))


def joint_noise(samples: Samples, law: FrictionLaw, pull: float) -> np.ndarray:
    """RMS residual per joint of the pulled weighted fit [N m], shape (n,); never zero."""
    torque = samples.torque
    matrix, nominal = samples.matrix(law), samples.columns.nominal(law)
    # one Gram matrix for each joint: weights only scale them
    both = np.concatenate([matrix, torque[:, :, None]], axis=2).transpose(1, 2, 0)
    by_joint = both @ both.transpose(0, 2, 1)
    # weights and fit depend on each other: a few rounds suffice
    noise = np.maximum(torque.std(axis=0), 1e-6 * np.abs(torque).max() + 1e-12)
    least = 1e-4 * rms(torque) + 1e-12
    for _ in range(3):
        gram = np.tensordot(noise**-2.0, by_joint, axes=1)
        penalty = pull * penalties(samples, law, np.diag(gram)[:-1])
        x = pulled_solution(gram, torque.size, penalty, nominal)
        noise = np.maximum(rms(torque - matrix @ x), least)
    return noise
