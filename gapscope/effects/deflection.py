"""Joints between motor and link: deflection by springs, and within free play."""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg.lapack import dtbtrs

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion

# The motion of links behind springs, step by step, as a triangular band of equations that is set up once.


class SpringRecursion:
    """Delta of e joints over S steps, for any driving torque.

        (m + d) x[i+1] + (k - 2 m) x[i] + (m - d) x[i-1] = torque[i]

    Joints with m = d = 0 follow k x[i] = torque[i]. Solved for x[i+1], each step is a row of blocks below a diagonal of
    ones.

    Args:
        m, d, k: mass over h^2, damping over 2 h, and stiffness, (S, e, e).

    Raises:
        numpy.linalg.LinAlgError: a step does not determine the next one.
    """

    def __init__(self, m: np.ndarray, d: np.ndarray, k: np.ndarray) -> None:
        self._moving = np.diagonal(m, axis1=1, axis2=2)[0] > 0
        moves = self._moving[:, None]
        # a row without mass is k x[i+1] = torque[i+1]: the step does not look back
        lead = np.where(moves, (m + d)[1:-1], k[2:])
        now = np.where(moves, (k - 2 * m)[1:-1], 0.0)
        before = np.where(moves, (m - d)[1:-1], 0.0)
        self._inverse = _inverse(lead)
        # the static value, the least one where a stiffness is missing
        self._at_rest = np.linalg.pinv(k[0], rcond=1e-9)
        self._band = _band(self._inverse @ now, self._inverse @ before)

    def follow(self, torque: np.ndarray) -> np.ndarray:
        """Delta (S, e) under a torque (S, e), from its static value."""
        right = np.where(self._moving, torque[1:-1], torque[2:])
        pushed = self._inverse @ right[:, :, None]
        start = self._at_rest @ torque[0]
        return self._solve(start[:, None], pushed)[:, :, 0]

    def changes(self, delta: np.ndarray, damping: np.ndarray, h: float) -> np.ndarray:
        """Derivatives of delta (S, e) by the stiffness of each joint, then by its damping, (S, e, 2 e).

        Args:
            delta: as ``follow`` gives it.
            damping: derivative of each joint's damping by its stiffness, (S, e).
            h: step [s].
        """
        # one more of k or d pushes its own joint back by delta or its rate, at the sample that the step is about
        rate = np.where(self._moving, (delta[2:] - delta[:-2]) / (2 * h), 0.0)
        # by the sample that each row of the recursion is about
        about = np.where(self._moving, delta[1:-1], delta[2:])
        by_stiffness = about + damping[1:-1] * rate
        blocks = [-self._inverse * x[:, None, :] for x in (by_stiffness, rate)]
        # the static value by k: -k^-1 delta; a damper does nothing at rest
        start = np.hstack([-self._at_rest * delta[0], np.zeros_like(self._at_rest)])
        return self._solve(start, np.concatenate(blocks, axis=2))

    def _solve(self, start: np.ndarray, pushed: np.ndarray) -> np.ndarray:
        """Delta for R right-hand sides, (S, e, R): its first two samples (e, R), and what pushes the others."""
        # from rest: both of the first samples are the same
        right = np.concatenate([start[None], start[None], pushed])
        flat = right.reshape(-1, right.shape[2])
        found, _ = dtbtrs(self._band, flat, uplo="L", diag="U")
        return found.reshape(right.shape)


def _inverse(blocks: np.ndarray) -> np.ndarray:
    """Inverse of blocks (S, e, e); of a single joint, of which many are tried, a division."""
    if blocks.shape[1] > 1:
        return np.linalg.inv(blocks)
    if not blocks.all():
        raise np.linalg.LinAlgError("no inertia, damping or stiffness")
    return 1.0 / blocks


def _band(now: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Blocks (S - 2, e, e) by which a step depends on the last two, as LAPACK stores a lower band: (3 e, S e)."""
    steps, e = len(now), now.shape[1]
    # entry (i, j) of the equations lies in row i - j, column j of the band, which is kept column by column
    columns = np.zeros((steps + 2, e, 3 * e))
    for a in range(e):
        for b in range(e):
            columns[1:-1, b, e + a - b] = now[:, a, b]
            columns[:-2, b, 2 * e + a - b] = before[:, a, b]
    return columns.reshape(-1, 3 * e).T


# Torque of the bodies behind elastic joints whose motors, not links, carry the encoders.


Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Derivatives of the bodies' torque by position, velocity and acceleration, (N, n, n) each."""
FASTEST_FOLLOWED = 40.0
"""A faster resonance is not integrated: the joint deflects at once [Hz]."""
PHASE_PER_STEP = 0.2
"""Steps are no longer than this share of a radian of the fastest resonance that is followed."""
FARTHEST = 1e3
"""Links that lag farther than this have run away [rad]."""
LIGHTEST = 1e-9
"""Least inertia about a joint [kg m^2]."""
CALM = 0.3
"""For this long springs are damped critically at first, if the arm moves: how they swung before is not known [s]."""


def through_springs(
    matrices: Matrices,
    motion: Motion,
    torque: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> np.ndarray:
    """Torque of bodies that follow the motors through springs [N m], shape (N, n).

    The links lag the motors by delta, which to first order obeys

        M delta'' + (C + D) delta' + (G + K) delta = tau

    with tau the torque as if delta were zero, C and G its derivatives by velocity and position, and K, D the springs
    and dampers; the torque is tau - M delta'' - C delta' - G delta. Central differences, from rest; of an arm that
    moves already, with more damping for the first ``CALM`` seconds. Joints without a spring have delta = 0.

    Args:
        matrices: derivatives of the bodies' torque by the motors' position, velocity and acceleration.
        motion: of the motors.
        torque: inverse dynamics of that [N m], shape (N, n).
        stiffness, damping: per joint [N m/rad], [N m s/rad], shape (n,); 0 if there is no spring.
    """
    springs = Springs(matrices, motion, torque, stiffness, damping)
    return torque - springs.of_bodies(springs.delta[:, :, None])[:, :, 0]


class Springs:
    """Links that follow their motors through springs; the arguments are those of ``through_springs``.

    Attributes:
        elastic: the joints with a spring, (e,).
        delta: by which their links lag, on steps as fine as the resonances need, (S, e).
        followed: whether it was integrated; if links ran away from their motors, springs are taken to bend at once.
    """

    def __init__(
        self,
        matrices: Matrices,
        motion: Motion,
        torque: np.ndarray,
        stiffness: np.ndarray,
        damping: np.ndarray,
    ) -> None:
        rate = motion.rate
        self.elastic = np.flatnonzero(stiffness > 0)
        self._matrices, self._stiffness = matrices, stiffness[self.elastic]
        block = np.ix_(np.arange(len(torque)), self.elastic, self.elastic)
        by_position, by_velocity, mass = (matrix[block] for matrix in matrices)
        # bodies of no or negative mass, on the way of a search, follow at once
        lightest = np.diagonal(mass, axis1=1, axis2=2).min(axis=0)
        frequency = np.sqrt(self._stiffness / np.maximum(lightest, LIGHTEST))
        # a resonance too fast to integrate deflects at once: it has neither mass nor damper
        slow = frequency <= 2 * np.pi * FASTEST_FOLLOWED
        fastest = max(frequency[slow], default=0.0)
        self._parts = int(np.ceil(fastest / rate / PHASE_PER_STEP)) or 1
        self._step = 1.0 / (rate * self._parts)
        # critical damping that fades over the first ``CALM`` seconds: springs of an arm that stands still do not swing
        fading = 1.0 - np.arange(len(mass)) * (1.0 / rate) / CALM
        calm = 2 * np.clip(fading, 0.0, 1.0)[:, None, None] * _moves_at_first(motion)
        calmed = calm * frequency * mass * np.eye(len(frequency))
        d = by_velocity + np.diag(damping[self.elastic]) + calmed
        keep = np.outer(slow, slow)
        k = by_position + np.diag(self._stiffness)
        series = (mass * keep, d * keep, k, torque[:, self.elastic])
        # every step cut into parts, by one spline for all
        flat = [x.reshape(len(x), -1) for x in series]
        edges = np.cumsum([x.shape[1] for x in flat])[:-1]
        cut = np.split(finer(np.hstack(flat), self._parts), edges, axis=1)
        m, d, k, driving = (
            x.reshape(-1, *like.shape[1:]) for x, like in zip(cut, series, strict=True)
        )
        self._calmed = np.diagonal(calmed, axis1=1, axis2=2)
        self.delta = np.full_like(driving, np.nan)
        # of bodies without mass a step does not determine the next
        with suppress(np.linalg.LinAlgError):
            h = self._step
            self._recursion = SpringRecursion(m / h**2, d / (2 * h), k)
            self.delta = self._recursion.follow(driving)
        # springs too soft to hold their links let them run away, and negative masses on the way of a search
        finite = bool(np.isfinite(self.delta).all())
        self.followed = finite and bool(np.abs(self.delta).max() <= FARTHEST)
        if not self.followed:
            inverse = np.linalg.pinv(k, rcond=1e-9)
            at_once = np.einsum("nij,nj->ni", inverse, driving)
            self.delta = np.clip(at_once, -FARTHEST, FARTHEST)

    @cached_property
    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the torque [N m] by each spring's stiffness, and by its damping, (N, n, e); if followed."""
        # the damping at first is critical for the stiffness, and grows with its root
        calmed = finer(0.5 * self._calmed / self._stiffness, self._parts)
        changes = self._recursion.changes(self.delta, calmed, self._step)
        torque = -self.of_bodies(changes)
        e = len(self.elastic)
        return torque[:, :, :e], torque[:, :, e:]

    def of_bodies(self, delta: np.ndarray) -> np.ndarray:
        """What R lags, (S, e, R), take from the bodies' torque [N m], (N, n, R)."""
        rates = _with_rates(delta, self._step)
        parts = [
            matrix[:, :, self.elastic] @ x[:: self._parts]
            for matrix, x in zip(self._matrices, rates, strict=True)
        ]
        return sum(parts)


def _moves_at_first(motion: Motion) -> float:
    """How fast an arm moves at first, over the usual speed of the joint that moves most, at most 1 [1]."""
    usual = np.sqrt((motion.dq**2).mean(axis=0))
    first = np.abs(motion.dq[0])
    moving = usual > 0
    return float(np.clip(first[moving] / usual[moving], 0.0, 1.0).max(initial=0.0))


def finer(series: np.ndarray, parts: int) -> np.ndarray:
    """A series (N, ...) with every step cut into parts, by a cubic spline."""
    if parts == 1:
        return series
    count = len(series)
    spline = make_interp_spline(np.arange(count), series, k=3)
    fine = np.arange((count - 1) * parts + 1) / parts
    return spline(fine)


def _with_rates(delta: np.ndarray, h: float) -> Matrices:
    """Delta (S, ...) and its first two derivatives by time, by central differences over steps of h [s]."""
    rate = np.gradient(delta, h, axis=0)
    acceleration = np.gradient(rate, h, axis=0)
    # narrower, as those of the recursion, so that the upper end of the band is not damped
    after, before = delta[2:], delta[:-2]
    acceleration[1:-1] = (after - 2 * delta[1:-1] + before) / h**2
    return delta, rate, acceleration


def of_bodies(
    matrices: tuple[np.ndarray, ...], series: tuple[np.ndarray, ...]
) -> np.ndarray:
    """G delta + C delta' + M delta'' [N m], shape (N, n)."""
    moved = np.flatnonzero(series[0].any(axis=0))
    out = np.zeros_like(series[0])
    for matrix, x in zip(matrices, series, strict=True):
        out += (matrix[:, :, moved] * x[:, None, moved]).sum(axis=2)
    return out


# Torque of the bodies behind free play whose motors, not links, carry the encoders.


CONTACT = 40.0
"""Frequency at which a link swings on the flank of a gear whose stiffness is not known [Hz]."""
CONTACT_DAMPING = 0.6
"""Its damping ratio [1]: teeth in grease hardly rebound, and no recording tells when a rebound ends."""
LONGEST_STEP = 2e-3
"""Steps with which free play is followed are no longer [s]: within one a link hardly leaves its flank."""


def through_play(
    matrices: Matrices,
    motion: Motion,
    torque: np.ndarray,
    width: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> np.ndarray:
    """Torque of bodies that follow the motors through free play [N m], shape (N, n).

    As ``through_springs``, with the spring's torque K (delta - w / 2 sgn delta) + D delta' outside the free play
    abs(delta) < w / 2 and none inside it, where the link floats. Implicit Euler steps of ``LONGEST_STEP``, one joint
    at a time; a joint without a spring has a contact of ``CONTACT``.

    Args:
        matrices, motion, torque, stiffness, damping: as for ``through_springs``.
        width: whole free play per joint [rad], shape (n,); 0 if there is none.
    """
    deltas = _deflections(matrices, motion.rate, torque, width, stiffness, damping)
    return torque - of_bodies(matrices, deltas)


def play_columns(
    body: RigidBody, motion: Motion, torque: np.ndarray, width: np.ndarray
) -> np.ndarray:
    """Torque that a little free play on each joint alone adds, per radian of it [N m/rad], shape (N, n, n).

    Entry (i, j) is that of joint i from play on joint j; of joints whose torque keeps its sign there is none.

    Args:
        body: the bodies.
        motion: of the motors.
        torque: as for ``through_springs``.
        width: free play [rad or m], (n,).
    """
    matrices = body.sensitivities(motion.q, motion.dq, motion.ddq)
    none = np.zeros(torque.shape[1])
    # a joint whose torque keeps its sign stays on one flank of its gear
    reverses = (torque.min(axis=0) < 0) & (torque.max(axis=0) > 0)
    deltas = _deflections(matrices, motion.rate, torque, width * reverses, none, none)
    pairs = zip(matrices, deltas, strict=True)
    return -sum(matrix * delta[:, None, :] for matrix, delta in pairs) / width


def _deflections(
    matrices: Matrices,
    rate: float,
    torque: np.ndarray,
    width: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
) -> Matrices:
    """Delta of joints with free play and its first two derivatives by time, (N, n) each."""
    deltas = (np.zeros_like(torque), np.zeros_like(torque), np.zeros_like(torque))
    parts = max(1, int(np.ceil(1.0 / (rate * LONGEST_STEP))))
    h = 1.0 / (rate * parts)
    for j in np.flatnonzero(width):
        by_position, by_velocity, mass = (matrix[:, j, j] for matrix in matrices)
        # bodies of no or negative mass, on the way of a search, are light ones here
        mass = np.maximum(mass, LIGHTEST)
        k, d, half = stiffness[j], damping[j], 0.5 * width[j]
        if not k:
            # a contact that is not known
            k = float(mass.mean()) * (2 * np.pi * CONTACT) ** 2
            d = 2 * CONTACT_DAMPING * float(np.sqrt(k * mass.mean()))
        series = np.column_stack([mass, by_velocity, by_position, torque[:, j]])
        fine = finer(series, parts)
        delta = _play(fine, k, d, half, h)
        held = np.isfinite(delta).all() and np.abs(delta).max() <= half + FARTHEST
        # a link that ran away is taken to lie on the flank that the torque presses
        if not held:
            delta = half * np.sign(fine[:, 3])
        followed = _with_rates(delta[::parts], 1.0 / rate)
        for whole, own in zip(deltas, followed, strict=True):
            whole[:, j] = own
    return deltas


def _play(
    series: np.ndarray, stiffness: float, damping: float, half: float, h: float
) -> np.ndarray:
    """Delta (N,) of one joint with free play of half the width ``half`` [rad], by implicit steps of h [s].

    Args:
        series: of its own equation M delta'' + C delta' + G delta = torque: M [kg m^2], C [N m s/rad], G [N m/rad] and
            the torque [N m], (N, 4).
        stiffness, damping: of the contact [N m/rad], [N m s/rad].
        half: [rad].
        h: [s].
    """
    m, c, g, torque = series.T
    out = np.empty(len(torque))
    # numbers of Python are faster than those of arrays, and overflow without a word: see ``held``
    half, k, damper = float(half), float(stiffness), float(damping / h)
    flank = half if torque[0] > 0 else -half
    # at rest on its flank, bent by the first torque
    start = flank + float(torque[0]) / k
    now, before = start, start
    # (m / h^2 + c / h + g) new = push + m / h^2 (2 now - before) + c / h now
    inertia = (m / h**2).tolist()
    drag = (c / h).tolist()
    inside = (m / h**2 + c / h + g).tolist()
    push = torque.tolist()
    contact = k + damper
    for i, floating in enumerate(inside):
        right = push[i] + inertia[i] * (2 * now - before) + drag[i] * now
        new = right / floating
        if new > half or new < -half:
            # beyond the play: the same step, with the contact on the flank that it meets
            flank = half if new > 0 else -half
            new = (right + k * flank + damper * now) / (floating + contact)
        before, now = now, new
        out[i] = new
    return out
