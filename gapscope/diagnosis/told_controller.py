"""A controller that nobody stated, where no torque was recorded: its gains, told by the weight of the trusted arm.

Of joint j, with p the torque that the nominal arm needs on the recorded motion, Y delta errors of its bodies as a data
sheet has them, F phi those of friction, rotor and offset, f what is fed forward and e = q_ref(t - d) - q,

    p + Y delta + F phi = f + kp e + kd (dq_ref - dq) + ki int e.

It is solved for what was measured, e = (p - f + Y delta + F phi) / kp - kd / kp (dq_ref - dq) - ..., since noise and
form of the torque shrink with the gains: as an equation of torques it would be explained best by an arm without weight.
Without feedforward, what is left of the gains is a scale of each joint's torque, on which the contrast of a diagnosis
decides beside all effects.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from gapscope.arm.case import Case
from gapscope.arm.control import FEEDFORWARDS, PD, PID
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.inertials import inertial_errors, inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST, rms
from gapscope.diagnosis.gap.commanded_torque import filled
from gapscope.diagnosis.gap.plausible_data import select_windows
from gapscope.diagnosis.setup_faults.references import (
    FRICTION,
    GAINS,
    SERIES,
    LawRows,
    late_references,
    law_filtered,
    law_rows,
    of_gains,
    referred,
)
from gapscope.diagnosis.thresholds import INERTIAL_ERROR, LAW_EXPLAINS, LAW_GAIN
from gapscope.effects.actuation import DELAY_TIME
from gapscope.envs.effect_ranges import Z95
from gapscope.model.conditioning import (
    MIN_FLOOR,
    TORQUE_CUTOFF,
    torque_scale,
)
from gapscope.model.design import LIKELY, WIDE
from gapscope.model.effective_samples import motion_samples, variance_inflation
from gapscope.model.equations import MIN_NOISE, ROUNDS, SETTLED
from gapscope.model.readings import MOTION_INDEPENDENT_RATE

RATE = 1000.0
"""Rate of a controller of which nothing is known [Hz]: that of most drives."""
LATEST = DELAY_TIME.bounds[1]
"""Time by which commands may take effect late [s], as of any delay."""
STATED = 0.1
"""Share by which stated friction and rotors may be off [1]. (hand)"""
TICK = 1.0 / (4 * TORQUE_CUTOFF)
"""Step of delays that are tried [s]."""

NAMES = ("kp", "kd", "ki")
OWN = (*FRICTION, "ddq")
"""Columns of a joint's own torque: friction, offset and rotor. They are the first of ``SERIES``."""


class Law(NamedTuple):
    """A hypothesis on the control law.

    Attributes:
        feedforward: one of ``FEEDFORWARDS``.
        follows: whether kd acts on the velocity's reference as well, or damps the motion alone.
        integrates: whether it has an integrator.
    """

    feedforward: str = "none"
    follows: bool = True
    integrates: bool = False


@dataclass(frozen=True)
class ToldController:
    """Gains of n joints, K of each: those of ``NAMES`` that the law has.

    Attributes:
        law: the likeliest law.
        delay: by which commands take effect late [s].
        gains, std: values and standard deviations, (n, K).
        left: share of the position's error that the law leaves unexplained [1], (n,).
    """

    law: Law
    delay: float
    gains: np.ndarray
    std: np.ndarray
    left: np.ndarray

    @property
    def told(self) -> np.ndarray:
        """Joints whose gain is told from none, by a law that explains their error, mask (n,)."""
        sure = self.gains[:, 0] > LIKELY * self.std[:, 0]
        # with inverse dynamics fed forward the error is what they lack, whatever that is
        explains = np.median(self.left) < LAW_EXPLAINS / LAW_GAIN
        known = explains and self.law.feedforward != "nominal"
        return np.asarray(sure & (self.left < LAW_EXPLAINS) & known)

    @property
    def controller(self) -> Controller:
        """The law with these gains."""
        kind = PID if self.law.integrates else PD
        gains: dict[str, Any] = dict(
            zip(NAMES, np.maximum(self.gains, 0.0).T, strict=False)
        )
        return kind(rate=RATE, feedforward=self.law.feedforward, **gains)

    @property
    def unsure(self) -> np.ndarray:
        """Share by which all torques of each joint may be off [1], (n,)."""
        return np.asarray(self.std[:, 0] / np.abs(self.gains[:, 0]))

    def scaled(self, share: np.ndarray, std: np.ndarray) -> ToldController:
        """With all torques divided by 1 - share, of that deviation, (n,): masses are no better known than before."""
        factor = 1.0 / np.maximum(1.0 - share, MIN_NOISE)
        gains = self.gains * factor[:, None]
        least = np.abs(gains) * (std * factor)[:, None]
        own = np.maximum(self.std * factor[:, None], least)
        return replace(self, gains=gains, std=own)

    def entry(self) -> dict[str, Any]:
        """The entry ``controller`` of a document."""
        told, gains = self.told, {}

        def shown(values: np.ndarray) -> list[Any]:
            each = zip(values.tolist(), told, strict=True)
            return [value if known else None for value, known in each]

        for name, value, std in zip(NAMES, self.gains.T, self.std.T, strict=False):
            half = Z95 * std
            ends = np.column_stack([value - half, value + half])
            gains[name] = {"value": shown(value), "interval": shown(ends)}
        return {
            "kind": self.controller.kind,
            "feedforward": self.law.feedforward,
            **gains,
            "delay": self.delay,
            "follows_velocity": self.law.follows,
            "left": self.left,
            "not_told": np.flatnonzero(~told) + 1,
            "declare": self.lines(),
        }

    def lines(self) -> str:
        """What to write into the case."""
        parts = [f"kind: {self.controller.kind}, rate: {RATE:g}"]
        # of a joint that rests they are any: no law explains its error
        gains = np.where(self.left[:, None] < 1.0, np.maximum(self.gains, 0.0), 0.0)
        for name, value in zip(NAMES, gains.T, strict=False):
            parts.append(f"{name}: [{', '.join(f'{v:.4g}' for v in value)}]")
        parts.append(f"feedforward: {self.law.feedforward}")
        text = f"controller: {{{', '.join(parts)}}}"
        lead = self.delay
        if not self.law.follows:
            # an ignored velocity acts like a reference that is late by kd / kp
            own = self.gains[self.told]
            lead += float(np.median(own[:, 1] / own[:, 0]))
        if lead > 0:
            text += f"\nimport: {{mend: {{reference: {{lead: {lead:.3g}}}}}}}"
        return text

    def sentences(self) -> list[str]:
        """What a reader has to know."""
        told, missed = (np.flatnonzero(x) for x in (self.told, ~self.told))
        every = []
        for k, name in enumerate(NAMES[:2]):
            own = zip(self.gains[told, k], Z95 * self.std[told, k], strict=True)
            every.append(f"{name} " + ", ".join(f"{v:.3g} ± {h:.2g}" for v, h in own))
        out = [
            "neither torque nor gains are given: the torque is that of the gains with which the robot file's masses "
            f"explain how far the arm stays behind its references, {' and '.join(every)} of joints "
            f"{', '.join(map(str, told + 1))} (95 %). All torques and effects count relative to these masses. To "
            f"state the controller: {self.lines()}"
        ]
        if len(missed):
            out.append(
                f"the gains of joints {', '.join(map(str, missed + 1))} are not told: these carry too little weight, "
                "or no law of gains explains their error; nothing that is said of them holds"
            )
        return out


def _with_references(case: Case, delay: float, follows: bool = True) -> Case:
    """The case with references as they took effect, whose velocities are zero if the controller ignores them."""

    def read(recording: Recording) -> Recording:
        if recording.q_ref is None:
            return recording
        q_ref, dq_ref = late_references(recording, recording.t, delay)
        return replace(recording, q_ref=q_ref, dq_ref=dq_ref * follows)

    return case.each(read)


def _refined(cost: Callable[[float], float], near: float) -> tuple[float, float]:
    """The least cost about one of the delays that are tried, and its delay [s]."""
    found = minimize_scalar(
        cost,
        bounds=(max(0.0, near - TICK), near + TICK),
        method="bounded",
        options={"xatol": TICK / 20},
    )
    return float(found.fun), float(found.x)


# Sums of products of the columns of each joint, errors of bodies before ``SERIES``, on which every law is algebra.


class _Rows:
    """Rows of recordings with references, M in all, of n joints.

    Attributes:
        bodies: errors of the bodies, which no delay changes, (M, n, 10 n).
        segment: number of the segment of each row, (M,).
        error: RMS of the position's error as recorded [rad], (n,).
        late: time of a command that the log does not tell, deviation [s].
        independent: samples of the motion that are independent.
        friction: prior deviations of ``OWN``, (n, 4): as large as the torque; rotors near what is stated of all.
    """

    def __init__(self, case: Case) -> None:
        arm, body = case.arm, RigidBody(case.arm)
        size = inertial_scale(body)
        errors = inertial_errors(body.inertial_parameters().ravel(), size)
        errors = size[:, None] * errors * INERTIAL_ERROR
        self._case, self._recordings = case, referred(case)
        segments = [s for _, some in self._recordings for s in some]
        moved = [
            (s, body.regressor(s.motion.q, s.motion.dq, s.motion.ddq)) for s in segments
        ]
        self.bodies = np.concatenate([law_filtered(x @ errors, s) for s, x in moved])
        seconds = sum(s.motion.t[-1] - s.motion.t[0] for s in segments)
        self.independent = motion_samples(float(seconds), MOTION_INDEPENDENT_RATE)
        # a log tells the time of a command to one row
        self.late = 1.0 / min(r.rate for r, _ in self._recordings) / np.sqrt(12.0)
        rows = law_rows(case, self._recordings)
        at = dict(zip(SERIES, np.moveaxis(rows.series, 2, 0), strict=True))
        # beside a delay any error is a speed, which explains itself
        self.segment, self.error = rows.segment, rms(at["error"], 0)
        column = np.column_stack([rms(at[name], 0) for name in OWN])
        self.friction = (
            WIDE * torque_scale(at["needed"])[:, None] / np.maximum(column, MIN_FLOOR)
        )
        if arm.armature.all():
            self.friction[:, OWN.index("ddq")] = STATED * arm.armature

    def columns(self, delay: float) -> np.ndarray:
        """All columns if commands take effect late [s], (M, n, P)."""
        series = law_rows(self._case, self._recordings, delay).series
        return np.concatenate([self.bodies, series], axis=2)


class _Solution(NamedTuple):
    """A law fitted.

    Attributes:
        gains, std: and their deviations, (n, K).
        left: RMS of what it leaves of the position's error [rad], (n,).
        weights: of the columns of each joint in what is left, (n, P).
    """

    gains: np.ndarray
    std: np.ndarray
    left: np.ndarray
    weights: np.ndarray


def _fitted(
    rows: _Rows, gram: np.ndarray, law: Law, inflation: np.ndarray
) -> _Solution:
    """A law fitted to sums of products by Gauss-Newton, joints weighed by what is left.

    The unknowns of a joint, W in all: errors of the bodies, which joints share, its friction, 1 / kp, kd / kp and
    ki / kp.

    Args:
        rows: whose sums they are.
        gram: of each joint, over the rows that count, (n, P, P).
        law: the law.
        inflation: rows that count as one, (n,).
    """
    n, p = gram.shape[:2]
    bodies, unit = 10 * n, np.eye(p)
    series = dict(zip(SERIES, unit[bodies:], strict=True))
    base, error = series["needed"] - series[law.feedforward], series["error"]
    damped = [series["rate"] if law.follows else -series["dq"]]
    if law.integrates:
        damped.append(series["integral"])
    # places of a joint's own unknowns behind those that it shares
    known, width = bodies + len(OWN), len(OWN) + 1 + len(damped)
    places = bodies + np.arange(n * width).reshape(n, width)
    own = np.hstack([np.tile(np.arange(bodies), (n, 1)), places])

    def size(columns: np.ndarray) -> np.ndarray:
        square = ((columns[..., None, :] @ gram)[:, 0] * columns).sum(axis=-1)
        return np.sqrt(np.maximum(square / len(rows.bodies), SMALLEST))

    errors = size(error)
    wide = WIDE * LIKELY**2 * errors
    prior = np.ones(bodies + n * width)
    widths = [wide / size(column) for column in (series["needed"], *damped)]
    prior[places] = np.column_stack([rows.friction, *widths])
    share = errors / (2 * size(base))
    value, left = np.zeros(len(prior)), errors / LIKELY
    for _ in range(ROUNDS):
        # a controller that acts late has more inertia to push
        late = rows.late * np.abs(value[own[:, known + 1]]) / share
        rotor = OWN.index("ddq")
        prior[places[:, rotor]] = np.hypot(rows.friction[:, rotor], late)
        # what bodies and friction were taken to have is in two columns
        taken = np.zeros((n, p))
        taken[:, :known] = value[own[:, :known]]
        x = np.zeros((n, p, own.shape[1]))
        x[:, :known, :known] = share[:, None, None] * np.eye(known)
        x[:, :, known] = base + taken
        x[:, :, known + 1 :] = -np.transpose(damped)
        target = error + share[:, None] * taken
        scaled = x * prior[own][:, None]
        weighed = scaled.transpose(0, 2, 1) @ gram
        weighed /= (left**2 * inflation)[:, None, None]
        normal, right = np.eye(len(prior)), np.zeros(len(prior))
        np.add.at(normal, (own[:, :, None], own[:, None]), weighed @ scaled)
        np.add.at(right, own, (weighed @ target[:, :, None])[:, :, 0])
        value = prior * np.linalg.solve(normal, right)
        weights = target - (x @ value[own][:, :, None])[:, :, 0]
        left = np.maximum(size(weights), MIN_NOISE * errors)
        before, share = share, value[own[:, known]]
        if np.allclose(share, before, rtol=SETTLED**2):
            break
        share = np.where(share > 0, share, before / 2)
    covariance = np.linalg.inv(normal) * prior[:, None] * prior
    # kp = 1 / a_0, and all others a_k / a_0; of a joint that rests a_0 is none
    mine = own[:, known:]
    a = value[mine]
    first = np.where(a[:, :1], a[:, :1], np.finfo(float).eps)
    gains = np.hstack([1.0 / first, a[:, 1:] / first])
    slope = np.eye(a.shape[1]) / first[:, None]
    slope[:, :, 0] = -gains / first
    spread = slope @ covariance[mine[:, :, None], mine[:, None]]
    variance = (spread * slope).sum(axis=2)
    return _Solution(gains, np.sqrt(np.maximum(variance, 0.0)), left, weights)


def told_controller(case: Case) -> ToldController:
    """The likeliest law of a case's controller, its gains and by how much its commands are late.

    Args:
        case: without torque, with references in a recording.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    rows, once = _Rows(case), np.ones(case.arm.n_joints)

    @cache
    def sums(delay: float) -> np.ndarray:
        x = rows.columns(delay).transpose(1, 0, 2)
        return np.asarray(x.transpose(0, 2, 1) @ x)

    def criterion(delay: float, law: Law) -> float:
        """Bayesian information criterion [nats]; no loop brakes less the faster it is. Source: schwarz1978."""
        found = _fitted(rows, sums(delay), law, once)
        if np.median(found.gains[:, 1]) < 0:
            return np.inf
        size = found.gains.size + (delay > 0)
        misfit = rows.independent * np.log(found.left).sum()
        return float(misfit + size * np.log(rows.independent) / 2)

    laws = [Law(*some) for some in itertools.product(FEEDFORWARDS, (True, False))]
    tried = itertools.product(np.arange(0.0, LATEST, TICK).tolist(), laws)
    least, delay, law = min((criterion(*one), *one) for one in tried)
    more = law._replace(integrates=True)
    one = _fitted(rows, sums(delay), more, once)
    # an integrator shows on most joints
    shows = np.median(one.gains[:, 2] / one.std[:, 2]) > LIKELY
    if shows and criterion(delay, more) < least:
        law = more
    at_once = criterion(0.0, law)
    later = _refined(lambda d: min(criterion(d, law), at_once), delay)
    _, delay = min((at_once, 0.0), later)
    gram, x, inflation = sums(delay), rows.columns(delay), once
    for _ in range(3):
        best = _fitted(rows, gram, law, inflation)
        residual = np.einsum("mjp,jp->mj", x, best.weights)
        inflation = variance_inflation(residual, rows.segment)
    # the scale is known as well as masses are, and what no law explains may be in any gain
    share = best.left / np.maximum(rows.error, SMALLEST)
    unsure = np.hypot(share, INERTIAL_ERROR)[:, None]
    # the gain of a joint that rests is beyond all numbers, and is not told
    with np.errstate(over="ignore", invalid="ignore"):
        std = np.hypot(best.std, best.gains * unsure)
        std[:, 1] = np.hypot(std[:, 1], best.gains[:, 0] * rows.late)
    return ToldController(law, delay, best.gains, std, share)


def with_told_controller(case: Case) -> tuple[Case, ToldController | None]:
    """The case with a controller that its references tell, if it has neither torque nor controller, and what they tell.

    It keeps its recordings, with a warning, if nothing is told of most joints.
    """
    every = (*case.recordings, *case.judged)
    referred = any(r.q_ref is not None for r in case.recordings)
    if (
        case.controller is not None
        or any(r.tau is not None for r in every)
        or not referred
    ):
        return case, None
    found = told_controller(select_windows(case))
    if 2 * found.told.sum() >= len(found.told):
        read = _with_references(case, found.delay, found.law.follows)
        return filled(replace(read, controller=found.controller)), found
    left = float(np.median(found.left))
    why = f"the likeliest law leaves {left:.0%} of the error, or the arm's weight tells too little"
    if left < LAW_EXPLAINS and found.law.feedforward == "nominal":
        why = "the controller seems to feed inverse dynamics forward, and the error is what these lack"
    refused = f"nor do the references tell the gains of a controller: {why}"
    return replace(case, warnings=(*case.warnings, refused)), None


# What a controller feeds forward, and how late it acts, by the torque that it commanded.


# whether the velocity's reference is followed is another question
WITH_GAINS = ((*GAINS, "one"), ("error", "dq", "one"))
WITHOUT = (("one",),)


def with_fed_forward(case: Case, seen: Case) -> Case:
    """The case with the feedforward, and with references as late, as its torque shows, and a warning; or as it is.

    Laws with free gains are compared on rows that they were not fitted to: what is declared stays unless another law
    explains the torque and leaves less by a factor.

    Args:
        case: the whole case.
        seen: what is looked at of it, with the arm of which its controller knows.
    """
    declared = case.controller
    of_law = [r for r in seen.recordings if r.q_ref is not None]
    recorded = of_law and all(r.tau is not None for r in of_law)
    if not isinstance(declared, PD) or not recorded:
        return case

    @cache
    def rows_of(delay: float) -> LawRows:
        return law_rows(seen, recordings, delay)

    def left(kind: str, delay: float, columns: Sequence[Any] = WITH_GAINS) -> float:
        """Share of the torque that a law leaves, median over joints that move [1]; infinite if none does."""
        rows = rows_of(delay)
        if not rows.moves.any():
            return np.inf
        every = []
        for j in np.flatnonzero(rows.moves):
            fits = [rows.fit(j, of_gains(kind), x, {"torque": 1.0}) for x in columns]
            every.append(min(share for _, share in fits))
        return float(np.median(every))

    # a law that misses no more than this explains the torque, and is not late
    little = LAW_EXPLAINS / LAW_GAIN
    try:
        recordings = referred(seen)
        at_once = {kind: left(kind, 0.0) for kind in FEEDFORWARDS}
        kind = min(at_once, key=lambda one: at_once[one])
        least, delay = at_once[kind], 0.0
        if least > little:
            later = np.arange(TICK, LATEST, TICK).tolist()
            near = min((left(kind, d), d) for d in later)
            best = _refined(lambda d: left(kind, d), near[1])
            least, delay = min((least, 0.0), near, best)
    except GapscopeError:
        # too short for any law; what needs the signals says so
        return case
    stated = at_once[declared.feedforward]
    # of a torque that is its law to the last digit both are zero
    if least > little or least * LAW_GAIN >= stated:
        return case
    # what a good model feeds forward is what the arm needs, whatever its controller is: the error has to count
    if least * LAW_GAIN > left(kind, delay, WITHOUT):
        return case
    lines = []
    if kind != declared.feedforward:
        lines.append(f"controller: {{feedforward: {kind}}}")
    if delay:
        lines.append(f"import: {{mend: {{reference: {{lead: {delay:.2g}}}}}}}")
        case = _with_references(case, delay)
    said = (
        f"the commanded torque contradicts the declared controller: it leaves {stated:.0%} of it whatever its gains; "
        f"{' and '.join(lines)} leaves {least:.1%} and is taken instead: write that into the case"
    )
    right = replace(declared, feedforward=kind)
    return replace(case, controller=right, warnings=(*case.warnings, said))
