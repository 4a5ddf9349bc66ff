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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

from gapscope.arm.case import Case
from gapscope.arm.control import FEEDFORWARDS, PD, PID, feedforward
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.inertials import inertial_errors, inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.reading import references
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.plausible_data import select_windows
from gapscope.diagnosis.setup_faults.references import GAINS, LAW_TORQUE, law_sums
from gapscope.diagnosis.thresholds import (
    FAULT_SIGN_WIDTH,
    INERTIAL_ERROR,
    LAW_EXPLAINS,
    LAW_GAIN,
    MOTION_INDEPENDENT_RATE,
)
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.effect_ranges import Z95
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    torque_scale,
)
from gapscope.model.design import LIKELY, WIDE
from gapscope.model.effective_samples import motion_samples, variance_inflation
from gapscope.model.equations import MIN_NOISE, SETTLED

RATE = 1000.0
"""Rate of a controller of which nothing is known [Hz]: that of most drives."""
LATEST = 0.2
"""Time by which commands may take effect late [s]. (physical)"""
STATED = 0.1
"""Share by which stated friction and rotors may be off [1]. (hand)"""
TICK = 1.0 / (4 * TORQUE_CUTOFF)
"""Step of delays that are tried [s]."""
ROUNDS = 12
"""Gauss-Newton steps. (budget)"""
FRICTION = ("dry", "viscous", "rotor", "offset")
COLUMNS = (*FRICTION, "needed", "error", "dq_ref", "dq", "integral", *FEEDFORWARDS[1:])
"""Series of each joint, behind errors of the bodies."""


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
    """Gains of n joints, K of each: kp, kd and, of a law with an integrator, ki.

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
        common: dict[str, Any] = {"rate": RATE, "feedforward": self.law.feedforward}
        kp, kd, *ki = np.maximum(self.gains, 0.0).T
        if ki:
            return PID(kp=kp, kd=kd, ki=ki[0], **common)
        return PD(kp=kp, kd=kd, **common)

    def scaled(self, share: np.ndarray, std: np.ndarray) -> ToldController:
        """With all torques divided by 1 - share, of that deviation, (n,): masses are no better known than before."""
        factor = 1.0 / np.maximum(1.0 - share, MIN_NOISE)
        gains = self.gains * factor[:, None]
        least = np.abs(gains) * (std * factor)[:, None]
        own = np.maximum(self.std * factor[:, None], least)
        return replace(self, gains=gains, std=own)

    def read(self, recording: Recording) -> Recording:
        """A recording with the references as they took effect, and the torque of the gains without feedforward."""
        if recording.q_ref is None:
            return recording
        q_ref, dq_ref = references(_late(recording, self.delay), "controller")
        dq_ref = dq_ref if self.law.follows else np.zeros_like(dq_ref)
        dq = recording.dq
        if dq is None:
            dq = np.gradient(recording.q, recording.t, axis=0)
        error = q_ref - recording.q
        series = [error, dq_ref - dq]
        if self.law.integrates:
            series.append(_integral(error, recording.rate))
        tau = np.einsum("nk,kmn->mn", self.gains, np.array(series))
        return replace(recording, q_ref=q_ref, dq_ref=dq_ref, tau=tau)

    @property
    def lead(self) -> float:
        """Lead of the recorded reference that stands for its delay, and for its velocity if that is ignored [s]."""
        own = self.gains[self.told]
        damped = 0.0 if self.law.follows else float(np.median(own[:, 1] / own[:, 0]))
        return self.delay + damped

    def entry(self) -> dict[str, Any]:
        """The entry ``controller`` of a document."""
        told = self.told
        gains = {}
        for name, value, std in zip(
            ("kp", "kd", "ki"), self.gains.T, self.std.T, strict=False
        ):
            half = Z95 * std
            known = [
                [float(v - h), float(v + h)] if t else None
                for v, h, t in zip(value, half, told, strict=True)
            ]
            gains[name] = {
                "value": [
                    float(v) if t else None for v, t in zip(value, told, strict=True)
                ],
                "interval": known,
            }
        return {
            "kind": self.controller.kind,
            "feedforward": self.law.feedforward,
            **gains,
            "delay": self.delay,
            "follows_velocity": self.law.follows,
            "left": self.left.tolist(),
            "not_told": [int(j) + 1 for j in np.flatnonzero(~told)],
            "declare": self.lines(),
        }

    def lines(self) -> str:
        """What to write into the case."""
        parts = [f"kind: {self.controller.kind}, rate: {RATE:g}"]
        for name, value in zip(("kp", "kd", "ki"), self.gains.T, strict=False):
            parts.append(f"{name}: [{', '.join(f'{max(v, 0.0):.4g}' for v in value)}]")
        parts.append(f"feedforward: {self.law.feedforward}")
        text = f"controller: {{{', '.join(parts)}}}"
        if self.lead > 0:
            text += f"\nimport: {{mend: {{reference: {{lead: {self.lead:.3g}}}}}}}"
        return text

    def sentences(self) -> list[str]:
        """What a reader has to know."""
        told = np.flatnonzero(self.told)
        every = []
        for name, k in (("kp", 0), ("kd", 1)):
            own = zip(self.gains[told, k], self.std[told, k], strict=True)
            every.append(
                f"{name} " + ", ".join(f"{v:.3g} ± {Z95 * s:.2g}" for v, s in own)
            )
        out = [
            "neither torque nor gains are given: the torque is that of the gains with which the robot file's masses "
            f"explain how far the arm stays behind its references, {' and '.join(every)} of joints "
            f"{', '.join(str(j + 1) for j in told)} (95 %). All torques and effects count relative to these masses. To "
            f"state the controller: {self.lines()}"
        ]
        missed = [str(j + 1) for j in np.flatnonzero(~self.told)]
        if missed:
            out.append(
                f"the gains of joints {', '.join(missed)} are not told: these carry too little weight, or no law of "
                "gains explains their error; nothing that is said of them holds"
            )
        return out

    @property
    def unsure(self) -> np.ndarray:
        """Share by which all torques of each joint may be off [1], (n,)."""
        return np.asarray(self.std[:, 0] / np.abs(self.gains[:, 0]))

    @property
    def refused(self) -> str:
        """Why no torque can be worked out."""
        left = float(np.median(self.left))
        why = f"the likeliest law leaves {left:.0%} of the error, or the arm's weight tells too little"
        if left < LAW_EXPLAINS and self.law.feedforward == "nominal":
            why = "the controller seems to feed inverse dynamics forward, and the error is what these lack"
        return f"nor do the references tell the gains of a controller: {why}"


def _integral(error: np.ndarray, rate: float) -> np.ndarray:
    """Integral of an error less its mean [rad s], (N, n): with what it began is not known."""
    series = np.cumsum(error, axis=0) / rate
    return np.asarray(series - series.mean(axis=0))


# Sums of products of the columns of each joint, on which every law is algebra.


class _Rows:
    """Rows of recordings with references, M in all, of n joints.

    Attributes:
        segment: number of the segment of each row, (M,).
        error: RMS of the position's error as recorded [rad], (n,).
        late: time of a command that the log does not tell, deviation [s].
        independent: samples of the motion that are independent.
        fixed: columns that no delay changes, (M, n, 10 n + 5).
    """

    def __init__(self, case: Case) -> None:
        self._arm, self._body = case.arm, RigidBody(case.arm)
        size = inertial_scale(self._body)
        errors = inertial_errors(self._body.inertial_parameters().ravel(), size)
        self._errors = size[:, None] * errors * INERTIAL_ERROR
        self._pairs = [
            (r, s) for r in case.recordings if r.q_ref is not None for s in condition(r)
        ]
        parts = [self._fixed(segment) for _, segment in self._pairs]
        self.fixed = np.concatenate(parts)
        self.segment = np.repeat(np.arange(len(parts)), [len(x) for x in parts])
        seconds = sum(s.motion.t[-1] - s.motion.t[0] for _, s in self._pairs)
        self.independent = motion_samples(float(seconds), MOTION_INDEPENDENT_RATE)
        # beside a delay any error is a speed, which explains itself
        recorded = self.columns(0.0)[:, :, self.fixed.shape[2]]
        self.error = np.sqrt((recorded**2).mean(axis=0))
        # a log tells the time of a command to one row
        self.late = 1.0 / min(r.rate for r, _ in self._pairs) / np.sqrt(12.0)

    def _thin(self, columns: Sequence[np.ndarray], segment: Segment) -> np.ndarray:
        """Columns, (N, n) or (N, n, K) each, behind the filter of the torque gap, (M, n, K)."""
        rate = segment.motion.rate
        x = np.concatenate([c.reshape(*c.shape[:2], -1) for c in columns], axis=2)
        step = max(1, int(rate / (4 * TORQUE_CUTOFF)))
        flat = low_pass(x.reshape(len(x), -1), rate, TORQUE_CUTOFF)
        return flat.reshape(x.shape)[segment.inner][::step]

    def _fixed(self, segment: Segment) -> np.ndarray:
        m = segment.motion
        bodies = self._body.regressor(m.q, m.dq, m.ddq) @ self._errors
        needed = CorrectedArm(self._arm).predict(segment.bodies(self._body), m)
        dry, one = np.tanh(m.dq / FAULT_SIGN_WIDTH), np.ones_like(m.q)
        return self._thin([bodies, dry, m.dq, m.ddq, one, needed], segment)

    def columns(self, delay: float) -> np.ndarray:
        """All columns if commands take effect late [s], (M, n, P)."""
        parts = [self._of_reference(r, s, delay) for r, s in self._pairs]
        return np.concatenate([self.fixed, np.concatenate(parts)], axis=2)

    def _of_reference(
        self, recording: Recording, segment: Segment, delay: float
    ) -> np.ndarray:
        m, t = segment.motion, recording.t
        late = np.maximum(m.t - delay, t[0])
        every = references(recording, "controller")
        q_ref, dq_ref = (make_interp_spline(t, x, k=1)(late) for x in every)
        dq = m.dq
        if recording.dq is not None:
            dq = make_interp_spline(t, recording.dq, k=1)(m.t)
        ddq_ref = make_interp_spline(m.t, dq_ref, k=3)(m.t, 1)
        error = q_ref - make_interp_spline(t, recording.q, k=1)(m.t)
        fed = [
            feedforward(self._arm, self._body, kind, q_ref, dq_ref, ddq_ref)
            for kind in FEEDFORWARDS[1:]
        ]
        integral = _integral(error, m.rate)
        return self._thin([error, dq_ref, dq, integral, *fed], segment)

    @property
    def friction(self) -> np.ndarray:
        """Prior deviations of ``FRICTION``, (n, 4): as large as the torque; rotors near what is stated of all."""
        arm, n = self._arm, self._arm.n_joints
        last = self.fixed[:, :, 10 * n :]
        size = np.sqrt((last**2).mean(axis=0))
        wide = (
            WIDE * torque_scale(last[:, :, -1])[:, None] / np.maximum(size[:, :4], 1e-9)
        )
        if arm.armature.all():
            wide[:, FRICTION.index("rotor")] = STATED * arm.armature
        return wide


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

    Args:
        rows: whose sums they are.
        gram: of each joint, over the rows that count, (n, P, P).
        law: the law.
        inflation: rows that count as one, (n,).
    """
    n, p = gram.shape[:2]
    bodies = 10 * n
    place = {name: bodies + k for k, name in enumerate(COLUMNS)}
    unit = np.eye(p)
    base = unit[place["needed"]].copy()
    if law.feedforward != "none":
        base -= unit[place[law.feedforward]]
    damped = [unit[place["dq_ref"]] * law.follows - unit[place["dq"]]]
    if law.integrates:
        damped.append(unit[place["integral"]])
    error, count = unit[place["error"]], len(rows.fixed)
    width = len(FRICTION) + 1 + len(damped)
    own = [np.r_[:bodies, bodies + j * width + np.arange(width)] for j in range(n)]
    size = bodies + n * width

    def rms(j: int, column: np.ndarray) -> float:
        return float(np.sqrt(max(column @ gram[j] @ column / count, 1e-30)))

    errors = np.array([rms(j, error) for j in range(n)])
    needed = np.array([rms(j, base) for j in range(n)])
    prior, friction = np.ones(size), rows.friction
    for j in range(n):
        others = [WIDE / rms(j, c) for c in damped]
        widths = np.array([WIDE / rms(j, unit[place["needed"]]), *others]) * errors[j]
        prior[own[j][bodies:]] = [*friction[j], *(widths * LIKELY**2)]
    share, value, left = errors / (2 * needed), np.zeros(size), errors / LIKELY
    weights = np.zeros((n, p))
    for _ in range(ROUNDS):
        normal, right, every = np.eye(size), np.zeros(size), []
        for j in range(n):
            # a controller that acts late has more inertia to push
            late = rows.late * abs(value[own[j][bodies + 5]]) / share[j]
            prior[own[j][bodies + 2]] = np.hypot(friction[j, 2], late)
            x = np.zeros((p, len(own[j])))
            x[: bodies + 4, : bodies + 4] = share[j] * np.eye(bodies + 4)
            known = np.r_[value[own[j][: bodies + 4]], np.zeros(p - bodies - 4)]
            x[:, bodies + 4] = base + known
            x[:, bodies + 5 :] = -np.array(damped).T
            # what bodies and friction were taken to have is in two columns
            target = error + share[j] * known
            scaled = x * prior[own[j]]
            weight = 1.0 / (left[j] ** 2 * inflation[j])
            normal[np.ix_(own[j], own[j])] += weight * scaled.T @ gram[j] @ scaled
            right[own[j]] += weight * scaled.T @ gram[j] @ target
            every.append((x, target))
        value = prior * np.linalg.solve(normal, right)
        for j, (x, target) in enumerate(every):
            weights[j] = target - x @ value[own[j]]
            left[j] = max(rms(j, weights[j]), MIN_NOISE * errors[j])
        before, share = share, np.array([value[one[bodies + 4]] for one in own])
        if np.allclose(share, before, rtol=SETTLED**2):
            break
        share = np.where(share > 0, share, before / 2)
    covariance = np.linalg.inv(normal) * prior[:, None] * prior
    gains, std = [], []
    for one in own:
        mine = one[bodies + 4 :]
        a = value[mine]
        # kp = 1 / a_0, and all others a_k / a_0; of a joint that rests a_0 is none
        first = a[0] or np.finfo(float).eps
        slope = np.eye(len(a)) / first
        slope[:, 0] = -a / first**2
        slope[0, 0] = -1.0 / first**2
        gains.append([1.0 / first, *(a[1:] / first)])
        variance = np.diag(slope @ covariance[np.ix_(mine, mine)] @ slope.T)
        std.append(np.sqrt(np.maximum(variance, 0.0)))
    return _Solution(np.array(gains), np.array(std), left, weights)


def _criterion(rows: _Rows, found: _Solution, further: int = 0) -> float:
    """Bayesian information criterion of a law [nats]; no loop brakes less the faster it is. Source: schwarz1978."""
    if np.median(found.gains[:, 1]) < 0:
        return np.inf
    size = found.gains.size + further
    return float(
        rows.independent * np.log(found.left).sum()
        + size * np.log(rows.independent) / 2
    )


def told_controller(case: Case) -> ToldController:
    """The likeliest law of a case's controller, its gains and by how much its commands are late.

    Args:
        case: without torque, with references in a recording.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    rows = _Rows(case)
    n = case.arm.n_joints
    once = np.ones(n)

    def sums(delay: float) -> np.ndarray:
        x = rows.columns(delay).transpose(1, 0, 2)
        return np.asarray(x.transpose(0, 2, 1) @ x)

    laws = [Law(*some) for some in itertools.product(FEEDFORWARDS, (True, False))]
    found = []
    for delay in np.arange(0.0, LATEST, TICK).tolist():
        gram = sums(delay)
        for law in laws:
            one = _fitted(rows, gram, law, once)
            found.append((_criterion(rows, one, int(delay > 0)), delay, law))
    least, delay, law = min(found)
    more = law._replace(integrates=True)
    one = _fitted(rows, sums(delay), more, once)
    # an integrator shows on most joints
    shows = np.median(one.gains[:, 2] / one.std[:, 2]) > LIKELY
    if shows and _criterion(rows, one, int(delay > 0)) < least:
        law = more

    at_once = _criterion(rows, _fitted(rows, sums(0.0), law, once))

    def cost(d: float) -> float:
        return min(_criterion(rows, _fitted(rows, sums(d), law, once), 1), at_once)

    near = minimize_scalar(
        cost,
        bounds=(max(0.0, delay - TICK), delay + TICK),
        method="bounded",
        options={"xatol": TICK / 20},
    )
    delay = float(near.x) if near.fun < at_once else 0.0
    gram, x, inflation = sums(delay), rows.columns(delay), once
    for _ in range(2):
        best = _fitted(rows, gram, law, inflation)
        residual = np.einsum("mjp,jp->mj", x, best.weights)
        inflation = variance_inflation(residual, rows.segment)
    best = _fitted(rows, gram, law, inflation)
    # the scale is known as well as masses are, and what no law explains may be in any gain
    share = best.left / np.maximum(rows.error, np.finfo(float).tiny)
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
    seen = select_windows(case)
    found = told_controller(seen)
    if 2 * found.told.sum() < len(found.told):
        return replace(case, warnings=(*case.warnings, found.refused)), None
    return _read(case, found), found


def _read(case: Case, found: ToldController) -> Case:
    """The case with the controller that was found, its references and torque."""
    arm, body, kind = case.arm, RigidBody(case.arm), found.law.feedforward

    def read(recording: Recording) -> Recording:
        done = found.read(recording)
        if done.q_ref is None or done.tau is None or kind == "none":
            return done
        planned = make_interp_spline(done.t, done.q_ref, k=3)
        motion = [done.q_ref, planned(done.t, 1), planned(done.t, 2)]
        return replace(done, tau=done.tau + feedforward(arm, body, kind, *motion))

    parts = (tuple(map(read, part)) for part in (case.recordings, case.judged))
    recordings, judged = parts
    return replace(
        case, recordings=recordings, judged=judged, controller=found.controller
    )


# What a controller feeds forward, and how late it acts, by the torque that it commanded.


def with_fed_forward(case: Case, seen: Case) -> Case:
    """The case with the feedforward, and with references as late, as its torque shows, and a warning; or as it is.

    Laws with free gains are compared on rows that they were not fitted to: what is declared stays unless another law
    explains the torque and leaves less by a factor.

    Args:
        case: the whole case.
        seen: what is looked at of it, with the arm of which its controller knows.
    """
    declared = case.controller
    recorded = all(r.tau is not None for r in seen.recordings if r.q_ref is not None)
    if not isinstance(declared, PD) or not recorded:
        return case
    try:
        left = {kind: _left(seen, kind, 0.0) for kind in FEEDFORWARDS}
        stated = left[declared.feedforward]
        kind = min(left, key=lambda one: left[one])
        later = np.arange(TICK, LATEST, TICK).tolist()
        # only a law that misses much can be late
        late = left[kind] > LAW_EXPLAINS / LAW_GAIN
        each = {d: _left(seen, kind, d) for d in (later if late else [])}
        if each:
            near = min(each, key=lambda d: each[d])
            best = minimize_scalar(
                lambda d: _left(seen, kind, float(d)),
                bounds=(near - TICK, near + TICK),
                method="bounded",
                options={"xatol": TICK / 20},
            )
            each[float(best.x)] = float(best.fun)
    except GapscopeError:
        # too short for any law; what needs the signals says so
        return case
    each[0.0] = left[kind]
    delay = min(each, key=lambda d: each[d])
    least = each[delay]
    if least > LAW_EXPLAINS / LAW_GAIN or least * LAW_GAIN > stated:
        return case
    # what a good model feeds forward is what the arm needs, whatever its controller is: the error has to count
    if least * LAW_GAIN > _left(seen, kind, delay, [("one",)]):
        return case
    lines = []
    if kind != declared.feedforward:
        lines.append(f"controller: {{feedforward: {kind}}}")
    if delay:
        lines.append(f"import: {{mend: {{reference: {{lead: {delay:.2g}}}}}}}")
    said = (
        f"the commanded torque contradicts the declared controller: it leaves {stated:.0%} of it whatever its gains; "
        f"{' and '.join(lines)} leaves {least:.1%} and is taken instead: write that into the case"
    )
    recordings, judged = (
        tuple(_late(r, delay) for r in part) for part in (case.recordings, case.judged)
    )
    return replace(
        case,
        recordings=recordings,
        judged=judged,
        controller=replace(declared, feedforward=kind),
        warnings=(*case.warnings, said),
    )


# whether the velocity's reference is followed is another question
WITH_GAINS = ((*GAINS, "one"), ("error", "dq", "one"))


def _left(
    case: Case,
    kind: str,
    delay: float,
    columns: Sequence[tuple[str, ...]] = WITH_GAINS,
) -> float:
    """Share of the torque that a law leaves, median over the joints that move [1]; infinite if none is recorded."""
    assert case.controller is not None
    controller = replace(case.controller, feedforward=kind)
    late = tuple(_late(r, delay) for r in case.recordings)
    sums = law_sums(replace(case, controller=controller, recordings=late))
    if sums is None or not sums.moves.any():
        return np.inf
    every = []
    for j in np.flatnonzero(sums.moves):
        fits = [sums.fit(int(j), LAW_TORQUE, one, {"torque": 1.0}) for one in columns]
        every.append(min(left for _, left in fits))
    return float(np.median(every))


def _late(recording: Recording, delay: float) -> Recording:
    """A recording with references as they took effect if that was late [s]."""
    if recording.q_ref is None or not delay:
        return recording
    t, late = recording.t, np.maximum(recording.t - delay, recording.t[0])
    q_ref, dq_ref = (
        make_interp_spline(t, x, k=1)(late) for x in references(recording, "controller")
    )
    return replace(recording, q_ref=q_ref, dq_ref=dq_ref)
